"""Readers of log formats: each opens a file as a `Log`."""
