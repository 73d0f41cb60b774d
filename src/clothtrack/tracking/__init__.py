"""Algorithm 1 of the paper: calibration, alignment, line search."""
