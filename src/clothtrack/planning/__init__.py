"""Flattening: which pick-and-place to try next, what it would do, and who carries it out."""
