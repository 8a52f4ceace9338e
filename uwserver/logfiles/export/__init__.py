"""Logs written in the formats of others, units and frames in their metadata."""
