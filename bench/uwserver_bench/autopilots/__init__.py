"""The benchmarks of MAVLink and of autopilots in the loop."""
