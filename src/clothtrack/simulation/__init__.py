"""dyn(x, a): position-based cloth on Warp, the picker and procedural garments."""
