"""Check for the optional dependencies of the simulated world: the extra [lab]."""

from clothtrack.files.extras import require_extra


def require_lab() -> None:
    """Check that the extra [lab] is installed."""
    require_extra("lab", ("mujoco",), "the simulated world")
