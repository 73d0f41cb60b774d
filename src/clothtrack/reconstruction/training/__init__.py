"""One resumable training loop for every network."""
