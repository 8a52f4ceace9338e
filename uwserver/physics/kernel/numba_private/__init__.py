"""All code that relies on private parts of numba: the linker (`linking`) and the cache of kernels (`caches`).

Both only save time: a world compiles in a quarter of the time and starts from files of a third of the size. A version of numba in which these parts
are different breaks this folder and no other. pyproject.toml names the versions that are known to fit, tests/unit/physics/kernel/numba_private says
what no longer fits, and `uwserver.physics.kernel.plain` works without them.
"""
