"""Reports on a recording, as one HTML page or as pictures: the tracks of the vehicles, the data of their sensors, and the errors of these data."""
