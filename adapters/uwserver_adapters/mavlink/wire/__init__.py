"""Bytes and messages of MAVLink, and one conversation. Knows no vehicle."""
