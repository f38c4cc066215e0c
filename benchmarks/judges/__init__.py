"""Judges that no one here wrote."""
