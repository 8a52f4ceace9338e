"""Links to peers, and the router between them and the vehicle."""
