"""What the adapters for autopilots in the loop share: servo channels to actuators, and what an autopilot's simulator interface reads."""
