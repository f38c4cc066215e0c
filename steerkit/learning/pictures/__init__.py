"""Pictures of learning: the paper's figures, a run, a policy."""
