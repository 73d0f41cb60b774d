"""What a result was made with: the commit, the versions, the machine."""

import importlib.metadata
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path

from clothtrack.version import __version__


def made_with(packages: Iterable[str]) -> dict[str, object]:
    """Versions, commit and machine, as plain values.

    Args:
        packages: distributions that the result depends on; those not installed are left out.
    """
    return {
        "clothtrack": __version__,
        "commit": commit(),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "packages": {name: version for name in packages if (version := _version(name))},
    }


def commit() -> str:
    """The commit of a checkout, or an empty text when this is an installed package."""
    asked = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return asked.stdout.strip() if asked.returncode == 0 else ""


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
