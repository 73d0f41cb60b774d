"""Mesh to cloud: test-time optimisation, nearest points, outlines."""
