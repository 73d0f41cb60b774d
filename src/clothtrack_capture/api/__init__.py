"""The functions of `import clothtrack_capture` and its command line; stages are loaded on use."""
