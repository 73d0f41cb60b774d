"""What `import clothtrack_capture` does, and the command line too; loads no stage by itself."""
