"""Built-in autopilot: guidance and control of a vehicle by its own simulated sensors."""
