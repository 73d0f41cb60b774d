"""Scripts that make the figures and videos of the documents."""
