"""Many copies of a world, stepped in one call: `uwserver.batch`.

Each copy is a world of its own, as `uwserver.load` builds it, with its seed, its clock and its water, and makes its ticks by the step of all worlds
(`uwserver.step.many`); one call lets all of them make theirs.
"""
