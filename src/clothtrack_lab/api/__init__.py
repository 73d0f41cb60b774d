"""What `import clothtrack_lab` does, and the command line too; loads no stage by itself."""
