"""What a result was made with: settings, commit, versions, machine and processor."""

import importlib.metadata
import json
import platform
import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidConfigError
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


def as_plain(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as they come back from JSON."""
    return json.loads(json.dumps(asked, default=str))


def require_same(path: Path, stored: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Refuse to continue work that was begun with other settings."""
    for name, was, now in _differing(stored, as_plain(asked)):
        raise InvalidConfigError(
            f"{path}: begun with another {name} ({was:.40}, now {now:.40}); choose another folder, "
            "or remove this one"
        )


def _differing(stored: Any, asked: Any, name: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield the name of each value that differs, with both values as JSON."""
    if isinstance(stored, Mapping) and isinstance(asked, Mapping):
        for key in sorted(set(stored) | set(asked)):
            inner = f"{name}.{key}" if name else key
            yield from _differing(stored.get(key), asked.get(key), inner)
    elif stored != asked:
        yield name, json.dumps(stored), json.dumps(asked)
