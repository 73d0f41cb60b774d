"""The robot interface for planning: four methods, positions in meters in the world frame."""

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.planning.action_space import PickPlace, Workspace
from clothtrack.recordings.recording import PickerPath


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """RGB-D picture.

    Attributes:
        time_s: time of the picture, on the robot's clock [s].
        camera: camera that took it, with intrinsics and pose in the world.
        depth_m: measured depth [m]; 0 where nothing was measured.
        color: color picture, red first; None: there is none.
    """

    time_s: float
    camera: Camera
    depth_m: Float[np.ndarray, "height width"]
    color: UInt8[np.ndarray, "height width 3"] | None = None


@dataclass(frozen=True)
class Reachability:
    """Whether an action can be carried out; if not, the reason."""

    reachable: bool
    reason: str = ""


@dataclass(frozen=True, eq=False)
class Execution:
    """Result of executing an action.

    Attributes:
        film: pictures taken during the motion, in order of time; may be empty.
        grasped: whether the gripper holds, or held, anything; None if unknown.
        error: reason for an early stop; empty if there was none.
    """

    path: PickerPath
    film: tuple[RgbdFrame, ...] = ()
    grasped: bool | None = None
    error: str = ""


@runtime_checkable
class PickPlaceRobot(Protocol):
    """An arm with a gripper, and a camera that sees the table."""

    def observe(self) -> RgbdFrame:
        """Return a picture with the arm out of view."""
        ...

    def check(self, action: PickPlace) -> Reachability:
        """Return whether the action is within all limits, without moving."""
        ...

    def execute(self, action: PickPlace) -> Execution:
        """Carry the action out.

        Raises:
            InvalidConfigError: the action is outside a limit; nothing has moved.
        """
        ...

    def home(self) -> None:
        """Move the arm to a pose where it hides no part of the table."""
        ...


@dataclass(frozen=True)
class MotionLimits:
    """Motion limits of a robot, checked over the whole path of the tip before it moves.

    Attributes:
        table_height_m: height of the table in the world [m].
        clearance_m: smallest distance of the tip from the table [m].
        speed: highest speed of the tip [m/s].
    """

    workspace: Workspace = field(default_factory=Workspace)
    table_height_m: float = 0.0
    clearance_m: float = 0.0
    speed: float = 0.25

    def refusal(self, points: Float[np.ndarray, "points 3"]) -> str:
        """Return why the tip must not go through these points [m]; empty if it may."""
        points = np.atleast_2d(np.asarray(points, dtype=np.float64))
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if len(bad):
            return f"waypoint {bad[0]} is {points[bad[0]].tolist()}: not finite"
        lowest = self.table_height_m + self.clearance_m
        low = int(np.argmin(points[:, 2]))
        if points[low, 2] < lowest:
            return (
                f"the tip would be at z = {points[low, 2]:.4f} m, lower than table_height_m + "
                f"clearance_m = {lowest:.4f} m"
            )
        out = np.flatnonzero(~self.workspace.holds(points))
        if not len(out):
            return ""
        point, bounds = points[out[0]], vars(self.workspace)
        for axis, (name, (least, most)) in enumerate(bounds.items()):
            if not least <= point[axis] <= most:
                return (
                    f"the tip would be at {name[0]} = {point[axis]:.4f} m, outside "
                    f"workspace.{name} ({least} to {most})"
                )
        return ""


def waypoints(action: PickPlace, hover_m: float = 0.0) -> Float[np.ndarray, "points 3"]:
    """Return the straight-line waypoints: above pick, down, up, across, down, up (VCD) [m].

    Args:
        hover_m: height above pick and place at which the empty gripper arrives and leaves [m]; at
            least the lift.
    """
    up = np.array([0.0, 0.0, max(hover_m, action.lift_m)])
    high = max(action.pick[2], action.place[2]) + action.lift_m
    over_pick, over_place = action.pick.copy(), action.place.copy()
    over_pick[2] = over_place[2] = high
    return np.stack(
        [action.pick + up, action.pick, over_pick, over_place, action.place, action.place + up]
    )
