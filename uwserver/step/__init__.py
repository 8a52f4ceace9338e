"""The order of a tick, in compiled code."""
