"""A world as a whole: its services, snapshots, saved states in files and messages, and the poses for viewers."""
