"""Neural Fitted Q Iteration: the algorithm."""
