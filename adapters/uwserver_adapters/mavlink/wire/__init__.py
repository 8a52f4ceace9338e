"""Bytes and messages of MAVLink, and the state of one conversation. Knows no vehicle."""
