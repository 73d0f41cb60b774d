"""Common code of several experiments: runs, rows, columns and command lines."""
