"""The state of a world: snapshots, saved states in files and messages, and the poses for viewers."""
