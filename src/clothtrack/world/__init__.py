"""The stand-in for reality: another physics engine, a depth camera with noise, a tool in the way."""
