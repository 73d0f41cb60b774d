"""Measures of a tracked trajectory, with and without truth, and their tables."""
