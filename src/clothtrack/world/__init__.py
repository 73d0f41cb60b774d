"""The stand-in for reality: another engine, a depth camera with noise, a tool in the way."""
