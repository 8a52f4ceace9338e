"""Plays a recording in place of a world, and converts other logs so that they can be played."""
