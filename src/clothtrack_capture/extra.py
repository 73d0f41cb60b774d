"""What reading other programs' files needs beyond tracking: the extra [capture]."""

from importlib.util import find_spec

from clothtrack.errors import InvalidConfigError
from clothtrack.files.extras import install_command

MODULES = ("lz4", "mcap", "rosbags", "zstandard")
"""What the extra brings. Nothing is loaded to find out whether it is there."""


def require_capture() -> None:
    """Check that the extra [capture] is installed.

    Raises:
        InvalidConfigError: with the command that installs it.
    """
    missing = [name for name in MODULES if find_spec(name) is None]
    if missing:
        raise InvalidConfigError(
            f"importing needs {', '.join(missing)}, which tracking does not; install with: "
            f"{install_command('capture')}"
        )
