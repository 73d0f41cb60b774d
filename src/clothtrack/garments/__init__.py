"""Garments as meshes: outlines, templates from pictures, triangulation."""
