"""Measurements of steerkit against its peers."""
