"""The physics of bodies in water, as arrays and compiled kernels. It knows no component of a vehicle."""

PHYSICS = 10
"""The version of the equations and their arrays. Increase it by one if the same state and commands give other bits. Recordings and saved states hold
it; those of another version are refused."""
