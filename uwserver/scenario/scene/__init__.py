"""What a world looks like, worked out of its scenario: the scene description that viewers and recordings read."""
