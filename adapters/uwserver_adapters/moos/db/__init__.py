"""The adapter `moosdb`: a MOOSDB of our own."""
