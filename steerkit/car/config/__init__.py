"""The file that describes a car."""
