"""What reading other programs' files needs beyond tracking: the extra [capture]."""

from clothtrack.files.extras import require_extra


def require_capture() -> None:
    """Check that the extra [capture] is installed.

    Raises:
        InvalidConfigError: with the command that installs it.
    """
    require_extra("capture", ("lz4", "mcap", "rosbags", "zstandard"), "importing")
