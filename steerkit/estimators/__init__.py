"""Estimators: blocks that learn a car's numbers while it drives, each with its interval and whether it is known yet."""
