"""The command `shot`: pictures of the web view, drawn by a browser without a desktop."""
