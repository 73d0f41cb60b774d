"""Scripts that draw or film what the documents show."""
