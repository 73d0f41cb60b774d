"""What `import clothtrack` offers to do: each function is a door to the room that does it."""
