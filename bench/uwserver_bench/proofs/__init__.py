"""Motions and contacts with a known answer, run through the kernel: what tests of physics and docs/validation.md compare with."""
