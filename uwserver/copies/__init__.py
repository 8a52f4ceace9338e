"""Many copies of a world, stepped in one call: `uwserver.batch`.

Each copy is a world of its own, as `uwserver.load` builds it, with its own seed, clock and water. One call of `uwserver.step.many` lets all
of them make their ticks, by the same step as a single world.
"""
