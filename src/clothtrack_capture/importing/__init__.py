"""Import of other programs' files as recordings."""
