"""Attacks: the cost of decoding them, and the effect of a flood on the ticks of a running server."""
