"""The contribution of the paper: calibration, alignment, line search, Algorithm 1."""
