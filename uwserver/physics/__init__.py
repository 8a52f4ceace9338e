"""The physics: arrays and kernels, which know no component."""

PHYSICS = 10
"""Version of the equations and of their arrays: one more when the same state and commands give other bits. Recordings and saved states
hold it, and those of another version are refused."""
