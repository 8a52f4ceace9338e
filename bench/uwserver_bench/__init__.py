"""What `uwserver bench` measures: physics against its peers, the server under clients, and its start. Never a unit test: times are read here."""
