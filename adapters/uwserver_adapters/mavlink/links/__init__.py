"""Ways on which peers come, and what goes where."""
