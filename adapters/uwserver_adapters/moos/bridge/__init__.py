"""The bridge between MOOS variables and the world. Nothing here knows a socket."""
