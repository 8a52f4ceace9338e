"""Propagation of sound between two points: rays of a layered sea, and their losses."""
