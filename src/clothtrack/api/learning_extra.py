"""The check for the extra [learn], which learning needs; it imports nothing."""

from clothtrack.files.extras import require_extra
from clothtrack.reconstruction.availability import EXTRA


def require_learning() -> None:
    """Check that the extra [learn] is installed.

    Raises:
        InvalidConfigError: it is missing; the message has the command that installs it.
    """
    require_extra("learn", EXTRA, "learning")
