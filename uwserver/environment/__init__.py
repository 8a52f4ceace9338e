"""Sea water, currents and gravity: functions of (position, time)."""
