"""The functions of `import clothtrack_lab` and its command line; stages are loaded on use."""
