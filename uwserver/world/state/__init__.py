"""A world as a whole: its held start, services, snapshots, saved states in files and messages, and the poses for viewers."""
