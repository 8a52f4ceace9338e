"""Sea water, currents, waves, light, sound and the Earth, as functions of position and time."""
