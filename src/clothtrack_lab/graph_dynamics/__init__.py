"""The published method's learned dynamics: a graph network over the mesh."""
