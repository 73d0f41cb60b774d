"""Training data of networks: simulated states, and pseudo-labels of real recordings."""
