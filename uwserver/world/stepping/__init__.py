"""The ticks of a world: requests, commands and autopilots, what the compiled step gets, the Python work at its stops, threads, and the stages in
which kernels are compiled."""
