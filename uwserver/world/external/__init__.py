"""Bodies that follow somebody else's poses: of a log, of another simulator, of a robot at sea. They have no dynamics here."""
