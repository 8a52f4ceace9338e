"""Cameras: pictures of rays, with the light of the water between."""
