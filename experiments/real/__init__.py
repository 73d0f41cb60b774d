"""Real recordings: per set, a converter to the recording format and a scorer of positions."""
