"""What the simulated world needs beyond tracking: the extra [lab]."""

from clothtrack.files.extras import require_extra


def require_lab() -> None:
    """Check that the extra [lab] is installed.

    Raises:
        InvalidConfigError: with the command that installs it.
    """
    require_extra("lab", ("mujoco",), "the simulated world")
