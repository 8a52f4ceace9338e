"""The scene description that viewers and recordings read, made from a scenario."""
