"""What several experiments share: runs, rows, columns, command lines."""
