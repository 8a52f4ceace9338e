"""Variables on one side, the world on the other. Knows no socket."""
