"""Alignment of a mesh to a cloud: test-time optimization, nearest points, outlines."""
