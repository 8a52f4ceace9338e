"""Instruments that measure velocities by the Doppler shift along slanted beams: velocity log and current profiler."""
