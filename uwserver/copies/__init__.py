"""Many copies of a world, stepped in one call: `uwserver.batch`.

Each copy is a world of its own, as `uwserver.load` builds it, with its seed, its clock and its water. What a tick costs is shared: compiled loops
run over the arrays of all copies, which they find by tables of addresses, and Python does what is rare, copy by copy.
"""
