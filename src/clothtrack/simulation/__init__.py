"""dyn(x, a): position-based cloth on Warp, and the picker."""
