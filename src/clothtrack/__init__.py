"""Know where every point of a crumpled cloth is, from one depth camera."""

__version__ = "0.1.0"
