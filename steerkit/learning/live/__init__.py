"""A page on the loopback that shows a run while it is being learned, beside it and without its help."""
