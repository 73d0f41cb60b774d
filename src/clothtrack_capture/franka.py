"""A Franka arm for flattening, through franky-control ([franka]).

All limits are checked before any motion. The arm moves in short straight legs and stops after each
to take a picture, which is slow and easy to stop by hand. Nothing moves unless `may_move` is set.
"""

import itertools
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, NotNegative, Positive
from clothtrack.files.extras import install_command
from clothtrack.planning.action_space import PickPlace, Workspace
from clothtrack.planning.robots.robot import (
    Execution,
    MotionLimits,
    Reachability,
    RgbdFrame,
    waypoints,
)
from clothtrack.recordings.recording import PickerPath

logger = logging.getLogger(__name__)

_HIGHEST_SPEED = 0.5
"""Highest speed that a configuration may allow [m/s]; cloth does not justify a faster arm near a
table."""

_DOWNWARDS = (1.0, 0.0, 0.0, 0.0)
"""Quaternion (x, y, z, w) of a flange that points down, x forward."""


@runtime_checkable
class Arm(Protocol):
    """The arm interface; positions are of the finger tips, in the arm's base frame [m]."""

    def position(self) -> Float[np.ndarray, " 3"]:
        """Return the current position of the tips [m]."""
        ...

    def move(self, position: Float[np.ndarray, " 3"], speed: float) -> None:
        """Move there in a straight line, fingers down, and stop; speed in m/s."""
        ...

    def open(self) -> None:
        """Open the fingers."""
        ...

    def close(self) -> bool:
        """Close the fingers and return whether they hold something."""
        ...


@dataclass(frozen=True, eq=False)
class FrankaConfig(Checked):
    """The cell around the arm.

    Attributes:
        limits: allowed positions and speed of the finger tips, in the world frame.
        base_from_world: rigid transform, world frame to the arm's base frame (hand-eye).
        home_m: waiting position of the tips, where the arm hides nothing of the table, world frame
            [m].
        hover_m: height above pick and place at which the empty gripper arrives and leaves [m].
        leg_m: longest straight leg between two stops while carrying cloth [m].
        press_m: depth below the visible surface at which the fingers close [m]; limited by the
            table.
    """

    limits: MotionLimits = field(
        default_factory=lambda: MotionLimits(
            workspace=Workspace((0.3, 0.7), (-0.3, 0.3), (0.0, 0.5)), clearance_m=0.002, speed=0.1
        )
    )
    base_from_world: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    home_m: tuple[float, float, float] = (0.35, 0.0, 0.45)
    hover_m: NotNegative = 0.12
    leg_m: Positive = 0.04
    press_m: NotNegative = 0.004

    def __post_init__(self) -> None:
        """Refuse an unsafe cell.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        if not 0.0 < self.limits.speed <= _HIGHEST_SPEED:
            raise InvalidConfigError(
                f"limits.speed is {self.limits.speed} m/s; it must be above 0 and at most "
                f"{_HIGHEST_SPEED}"
            )
        turn = self.base_from_world[:3, :3]
        if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0.0:
            raise InvalidConfigError(
                "base_from_world is not rigid; give the transform of the hand-eye calibration"
            )
        refusal = self.limits.refusal(np.array([self.home_m]))
        if refusal:
            raise InvalidConfigError(f"home_m is outside the limits: {refusal}")


class FrankaRobot:
    """`PickPlaceRobot` for one arm and one fixed camera."""

    def __init__(
        self,
        arm: Arm,
        camera: Callable[[], RgbdFrame],
        config: FrankaConfig | None = None,
        *,
        may_move: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Store arm and camera without moving anything.

        Args:
            arm: `FrankyArm`, or any other `Arm`.
            camera: function that takes a picture now; its camera pose is in the world frame.
            config: configuration of the cell.
            may_move: whether the arm may move at all.
            clock: clock for the measured path and the pictures [s].
        """
        self._arm, self._camera, self.config = arm, camera, config or FrankaConfig()
        self._may_move, self._clock = may_move, clock
        self._begun = clock()

    def observe(self) -> RgbdFrame:
        """Take a picture, regardless of the arm's state."""
        shown = self._camera()
        return RgbdFrame(self._clock() - self._begun, shown.camera, shown.depth_m, shown.color)

    def check(self, action: PickPlace) -> Reachability:
        """Return whether the whole path, from and back to home, is within the limits."""
        if not np.isfinite(action.pick).all() or not np.isfinite(action.place).all():
            return Reachability(False, "the action is not finite")
        legs = np.vstack([self.config.home_m, self._points(action), self.config.home_m])
        reason = self.config.limits.refusal(subdivided(legs, 0.01))
        return Reachability(not reason, reason)

    def execute(self, action: PickPlace) -> Execution:
        """Pick and place, and return the measured path and a picture from every stop.

        Raises:
            InvalidConfigError: the action is outside a limit, or motion is not allowed. Nothing has
                moved then.
        """
        reachability = self.check(action)
        if not reachability.reachable:
            raise InvalidConfigError(f"refused before moving: {reachability.reason}")
        self._require_motion()
        way = _MeasuredPath(self)
        points = self._points(action)
        grasped: bool | None = None
        error = ""
        try:
            self._arm.open()
            way.stop(closed=False)
            for number, (start, end) in enumerate(itertools.pairwise(points)):
                if number == 0:
                    self._go(points[0])
                carrying = 1 <= number <= 3
                for point in subdivided(np.stack([start, end]), self._leg(carrying))[1:]:
                    self._go(point)
                    way.stop(closed=carrying)
                if number == 0:
                    grasped = self._arm.close()
                    way.stop(closed=True)
                elif number == 3:
                    self._arm.open()
                    way.stop(closed=False)
        except Exception as failure:
            # Catch every driver error: the arm has stopped, and the operator must know.
            logger.exception("the arm stopped")
            error = f"{type(failure).__name__}: {failure}"
        return Execution(way.path(), tuple(way.film), grasped, error)

    def home(self) -> None:
        """Move home, where the arm hides nothing; do nothing unless motion is allowed.

        The arm first moves straight up from its current position.
        """
        if not self._may_move:
            return
        config = self.config
        here = self._here()
        up = np.array([here[0], here[1], max(here[2], config.home_m[2])])
        legs = subdivided(np.stack([up, np.array(config.home_m)]), 0.01)
        refusal = config.limits.refusal(legs)
        if refusal:
            raise InvalidConfigError(f"refused before moving: the way home: {refusal}")
        self._go(up)
        self._go(np.array(config.home_m))

    def _points(self, action: PickPlace) -> Float[np.ndarray, "points 3"]:
        """Return the waypoints, with fingers just below the visible surface, above the table."""
        config = self.config
        lowest = config.limits.table_height_m + config.limits.clearance_m
        # A pick that is already below the limit is left unchanged, so that it is refused.
        pressed = min(action.pick[2], max(action.pick[2] - config.press_m, lowest))
        pick = np.array([action.pick[0], action.pick[1], pressed])
        return waypoints(PickPlace(pick, action.place, action.lift_m), config.hover_m)

    def _leg(self, carrying: bool) -> float:
        return self.config.leg_m if carrying else np.inf

    def _here(self) -> Float[np.ndarray, " 3"]:
        """Return the position of the tips in the world [m]."""
        turn, shift = self.config.base_from_world[:3, :3], self.config.base_from_world[:3, 3]
        return turn.T @ (self._arm.position() - shift)

    def _go(self, point: Float[np.ndarray, " 3"]) -> None:
        """Move one leg, after checking the limits again for any caller."""
        self._require_motion()
        refusal = self.config.limits.refusal(point[None])
        if refusal:
            raise InvalidConfigError(f"refused before moving: {refusal}")
        turn, shift = self.config.base_from_world[:3, :3], self.config.base_from_world[:3, 3]
        self._arm.move(turn @ point + shift, self.config.limits.speed)

    def _require_motion(self) -> None:
        if not self._may_move:
            raise InvalidConfigError(
                "nothing moves: the robot was made without may_move=True (--move on a command "
                "line); look at a dry run first"
            )

    def measured(self) -> tuple[float, Float[np.ndarray, " 3"]]:
        """Return the time [s] and the measured position of the tips in the world [m]."""
        return self._clock() - self._begun, self._here()


class _MeasuredPath:
    """Measurements of an arm at its stops."""

    def __init__(self, robot: FrankaRobot) -> None:
        self._robot = robot
        self.film: list[RgbdFrame] = []
        self._samples: list[tuple[float, Float[np.ndarray, " 3"], bool]] = []

    def stop(self, *, closed: bool) -> None:
        """Record the position of the tips, and take a picture."""
        time_s, tip = self._robot.measured()
        self._samples.append((time_s, tip, closed))
        frame = self._robot.observe()
        if not self.film or frame.time_s > self.film[-1].time_s:
            self.film.append(frame)

    def path(self) -> PickerPath:
        """Return the path with strictly increasing times."""
        kept: list[tuple[float, Float[np.ndarray, " 3"], bool]] = []
        for sample in self._samples:
            if not kept or sample[0] > kept[-1][0]:
                kept.append(sample)
            else:
                kept[-1] = (kept[-1][0], sample[1], sample[2])
        return PickerPath(
            np.array([one[0] for one in kept]),
            np.array([one[1] for one in kept]).reshape(-1, 3),
            np.array([one[2] for one in kept], dtype=bool),
        )


def subdivided(
    points: Float[np.ndarray, "points 3"], longest_m: float
) -> Float[np.ndarray, "more_points 3"]:
    """Return the same path with no leg longer than this [m]."""
    parts = [points[:1]]
    for start, end in itertools.pairwise(points):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / longest_m - 1e-9)))
        parts.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(parts)


class FrankyArm:
    """An arm through franky-control; the server's version must match the robot's."""

    def __init__(self, address: str, *, speed_share: float = 0.05, force_n: float = 10.0) -> None:
        """Connect without moving anything.

        Args:
            address: network address of the robot.
            speed_share: share of the arm's own limits on speed, acceleration and jerk.
            force_n: grasping force of the fingers [N].

        Raises:
            InvalidConfigError: the extra [franka] is not installed.
        """
        try:
            # Import by name, because type checkers find the module in some installations only.
            franky = import_module("franky")
        except ImportError as error:
            raise InvalidConfigError(
                "a Franka arm needs franky-control, which is not installed; install with: "
                f"{install_command('franka')}"
            ) from error
        self._franky: Any = franky
        self._robot: Any = franky.Robot(address)
        self._gripper: Any = franky.Gripper(address)
        self._robot.relative_dynamics_factor = speed_share
        self._force_n = force_n

    def position(self) -> Float[np.ndarray, " 3"]:
        """Return the position of the end effector [m], base frame."""
        pose = self._robot.current_cartesian_state.pose.end_effector_pose
        return np.array(pose.translation, dtype=np.float64).reshape(3)

    def move(self, position: Float[np.ndarray, " 3"], speed: float) -> None:
        """Move in a straight line, fingers down."""
        franky = self._franky
        self._robot.translation_velocity_limit.set(float(speed))
        target = franky.Affine(position.tolist(), list(_DOWNWARDS))
        self._robot.move(franky.CartesianMotion(target, franky.ReferenceType.Absolute))

    def open(self) -> None:
        """Open the fingers wide."""
        self._gripper.open(0.05)

    def close(self) -> bool:
        """Close the fingers; any width counts as a grasp, because cloth is thin."""
        return bool(self._gripper.grasp(0.0, 0.03, self._force_n, epsilon_outer=0.08))
