"""The published reconstruction network: canonical coordinates, winding numbers and a warp field."""
