"""What the car server decides, as pure functions: who steers, what may pass, what to believe."""
