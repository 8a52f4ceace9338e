"""The benchmark of MOOS."""
