"""Predictive steering: the block, linear and nonlinear, its model of the car along the path, its programme."""
