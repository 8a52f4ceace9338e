"""Commands that serve: `run` a world, and `play` a recording."""
