"""Underwater sound from one point to another: rays of a layered sea, and what they lose on the way."""
