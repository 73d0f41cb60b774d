"""The robot protocol that executes actions, and its implementations."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.planning.robots.dry_run import DryRunRobot, pictures_of
    from clothtrack.planning.robots.robot import (
        Execution,
        MotionLimits,
        PickPlaceRobot,
        Reachability,
        RgbdFrame,
        waypoints,
    )
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "DryRunRobot",
    "Execution",
    "MotionLimits",
    "PickPlaceRobot",
    "Reachability",
    "RgbdFrame",
    "pictures_of",
    "waypoints",
]
