"""Bodies whose poses come from outside: from a log, another simulator or a robot at sea. They have no dynamics here."""
