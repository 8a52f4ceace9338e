"""The adapter `moos_text`: variables as lines of text."""
