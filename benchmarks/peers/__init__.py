"""What others wrote, to compare with; each needs packages of the extra `peers`."""
