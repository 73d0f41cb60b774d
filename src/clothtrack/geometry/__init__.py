"""Pure functions on arrays: meshes, cameras, visibility, distances, area, quality of a mesh."""
