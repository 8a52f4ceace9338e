"""Motions and contacts with a known answer, run through the kernel, for tests of physics and for docs/validation.md."""
