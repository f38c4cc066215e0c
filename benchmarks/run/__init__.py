"""Carry out suites: drives and trainings, their results on disk."""
