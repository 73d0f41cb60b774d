"""The function that long work calls to say how far it is."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with the name of the work, the steps done and the steps in all."""
