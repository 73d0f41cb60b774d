"""The version of the package, for everything that is written with it."""

__version__ = "0.1.0"
