"""The command that adds an optional extra to this installation.

clothtrack is on no package registry, so the command depends on where this copy came from.
"""

import importlib.metadata
import importlib.util
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote, urlsplit

from clothtrack.errors import InvalidConfigError


def require_extra(extra: str, modules: Sequence[str], work: str) -> None:
    """Check that an extra is installed, without importing it."""
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    if missing:
        raise InvalidConfigError(
            f"{work} needs {', '.join(missing)}, which tracking does not; install with: "
            f"{install_command(extra)}"
        )


def install_command(extra: str) -> str:
    """Return the command that installs an extra, such as `learn`, for this copy of clothtrack.

    For a copy installed from a folder or a wheel file, the command names that path and the running
    interpreter. For any other copy, only the command inside a checkout is known.
    """
    source = _installed_from()
    if source is None or not source[0].exists():
        verb = "make learn" if extra == "learn" else f"make EXTRAS={extra} install"
        return f"{verb} (in a checkout of clothtrack)"
    path, editable = source
    command = [sys.executable, "-m", "pip", "install"]
    if (path / "constraints.txt").is_file():
        command += ["-c", str(path / "constraints.txt")]
    return shlex.join([*command, *["-e"] * editable, f"{path}[{extra}]"])


def _installed_from() -> tuple[Path, bool] | None:
    """Return the folder or wheel file that pip noted (PEP 610), and whether it is editable."""
    try:
        noted = importlib.metadata.distribution("clothtrack").read_text("direct_url.json")
    except importlib.metadata.PackageNotFoundError:
        return None
    origin = json.loads(noted or "{}")
    url = urlsplit(origin.get("url", ""))
    if url.scheme != "file":
        return None
    return Path(unquote(url.path)), bool(origin.get("dir_info", {}).get("editable"))
