"""What learning needs beyond tracking: the extra [learn]. Nothing is loaded to find out."""

from clothtrack.files.extras import require_extra
from clothtrack.reconstruction.availability import EXTRA


def require_learning() -> None:
    """Check that the extra [learn] is installed.

    Raises:
        InvalidConfigError: with the command that installs it.
    """
    require_extra("learn", EXTRA, "learning")
