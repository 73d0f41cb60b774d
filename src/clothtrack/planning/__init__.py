"""Flattening: planning of pick-and-places, their predicted result, and their execution."""
