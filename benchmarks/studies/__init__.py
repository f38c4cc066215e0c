"""Single measurements: `python -m benchmarks study --list`."""
