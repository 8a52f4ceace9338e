"""`uwserver bench --against VENV`: compares this version with another one, in pairs of measurements."""
