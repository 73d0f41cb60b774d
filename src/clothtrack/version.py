"""The version of the package, which is stored in everything that it writes."""

__version__ = "0.1.0"
