"""Other programs' files become recordings."""
