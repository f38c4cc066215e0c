"""steerkit."""
