"""What a car experienced: transitions in memory, on disk, and to and from other programs."""
