"""What a car experienced: transitions in memory and on disk."""
