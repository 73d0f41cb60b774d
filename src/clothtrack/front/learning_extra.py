"""What learning needs beyond tracking: the extra [learn]. Nothing is loaded to find out."""

from clothtrack.errors import InvalidConfigError
from clothtrack.files.extras import install_command
from clothtrack.reconstruction.availability import EXTRA, missing_modules


def require_learning() -> None:
    """Check that the extra [learn] is installed.

    Raises:
        InvalidConfigError: with the command that installs it.
    """
    missing = missing_modules(EXTRA)
    if missing:
        raise InvalidConfigError(
            f"learning needs {', '.join(missing)}, which tracking does not; install with: "
            f"{install_command('learn')}"
        )
