"""Foreign cars as plants, each a file of the kind that users write: none shares its dynamics with `steerkit`."""
