"""The adapter `moos`: a client of a MOOSDB."""
