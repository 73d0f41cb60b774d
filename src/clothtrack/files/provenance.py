"""The commit, the versions, the machine and the processor that a result was made with."""

import importlib.metadata
import platform
import re
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from clothtrack.version import __version__

_VECTORS = ("avx512f", "avx2", "avx", "sse4_2", "sve", "asimd")
"""Vector instruction sets, as Linux calls them, the widest first."""


def made_with(packages: Iterable[str]) -> dict[str, object]:
    """Return versions, commit and machine, as plain values."""
    return {
        "clothtrack": __version__,
        "commit": commit(),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "packages": {name: version for name in packages if (version := _version(name))},
    }


@cache
def processor(listing: Path = Path("/proc/cpuinfo")) -> str:
    """Return the model of the processor, and its widest vector instructions.

    Kernels are compiled for the local processor, and another kind rounds the last bits differently.
    """
    try:
        text = listing.read_text("utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    found = dict(re.findall(r"^(model name|flags|Features)[ \t]*: *(.*)$", text, re.MULTILINE))
    flags = f"{found.get('flags', '')} {found.get('Features', '')}".split()
    widest = next((one for one in _VECTORS if one in flags), "")
    model = found.get("model name", platform.machine())
    return f"{model}, {widest}" if widest else model


def commit() -> str:
    """Return the commit of a checkout; empty for an installed package, or where there is no Git."""
    try:
        asked = subprocess.run(
            ["git", "describe", "--always", "--dirty"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=False,
        )
    except FileNotFoundError:
        return ""
    return asked.stdout.strip() if asked.returncode == 0 else ""


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
