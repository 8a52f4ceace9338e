"""The bodies of a world with everything that belongs to them, and the parts that keep bodies and water in a state."""
