"""Acoustic positioning: the instruments that ask beacons for their range and direction."""
