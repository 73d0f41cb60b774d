"""What networks learn from: simulated states, and pseudo-labels of real recordings."""
