"""What adapters for autopilots in the loop share: servo channels to actuators, stepping the world, and the IMU's reading."""
