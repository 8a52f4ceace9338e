"""The adapter `moos_text`: MOOS variables as lines of text."""
