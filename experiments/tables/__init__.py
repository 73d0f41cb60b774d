"""Scripts that print a table, of the paper or ours."""
