"""`uwserver bench --against VENV`: this version beside another one, measured in pairs."""
