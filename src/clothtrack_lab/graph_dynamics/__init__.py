"""Learned dynamics of the published method: a graph network over the mesh."""
