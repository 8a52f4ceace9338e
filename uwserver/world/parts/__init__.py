"""What all parts of a world share: the contract of a part, the profile that measures parts, and the view of a body."""
