"""Real recordings: a converter to the recording format and a scorer of positions per data set."""
