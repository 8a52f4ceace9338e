"""The sensors of a world: their places in the arrays, when they read, the Python work of readings, and the samples in flight."""
