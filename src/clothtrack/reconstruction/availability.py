"""Availability of the network: the modules that must be installed, and the packaged weights.

Nothing is loaded, because tracking checks this before it decides where its first mesh comes from.
"""

from importlib.util import find_spec
from pathlib import Path

EXTRA = ("torch", "safetensors")
"""Modules of the extra [learn] without which nothing can be learned or reconstructed."""

SHIPPED = Path(__file__).parent / "weights"
"""Folder of the weights that come with the package: tokens.safetensors, for every garment."""


def missing_modules(wanted: tuple[str, ...] | None = None) -> list[str]:
    """Return those of the modules, by default of the extra, that are not installed."""
    return [name for name in wanted or EXTRA if find_spec(name) is None]


def shipped_weights() -> Path | None:
    """Return the packaged weights of the token network; None if there are none."""
    path = SHIPPED / "tokens.safetensors"
    return path if path.is_file() else None
