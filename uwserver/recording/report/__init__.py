"""A recording as one HTML page, or as pictures: where vehicles went, what their sensors told, and how far that was from the truth."""
