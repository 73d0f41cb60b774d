"""A Franka arm as a `PickPlaceRobot`, through franky-control (pip install franky-control).

All limits are checked before any motion. The arm moves in short straight legs and stops after each
to take a picture, which is slow and easy to stop by hand. Nothing moves unless `may_move` is set.
No real arm has been driven with it (docs/flattening.md).
"""

import itertools
import logging
import time
from dataclasses import dataclass, field

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.robots.robot import (
    Execution,
    MotionLimits,
    Reachability,
    RgbdFrame,
    waypoints,
)
from clothtrack.recordings.recording import PickerPath

logger = logging.getLogger(__name__)

HIGHEST_SPEED = 0.5
"""Highest speed that a cell may allow [m/s]; cloth does not justify a faster arm near a table."""

DOWNWARDS = [1.0, 0.0, 0.0, 0.0]
"""Quaternion (x, y, z, w) of a flange that points down, x forward."""


@dataclass(frozen=True, eq=False)
class FrankaConfig:
    """The cell around the arm; lengths in m, `home_m` and `limits` in the world frame.

    Attributes:
        base_from_world: rigid transform, world frame to the arm's base frame (hand-eye).
        home_m: waiting position of the tips, where the arm hides nothing of the table.
        hover_m: height above pick and place at which the empty gripper arrives and leaves.
        leg_m: longest straight leg between two stops while carrying cloth.
        press_m: depth below the visible surface at which the fingers close; limited by the table.
    """

    limits: MotionLimits
    base_from_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    home_m: tuple[float, float, float] = (0.35, 0.0, 0.45)
    hover_m: float = 0.12
    leg_m: float = 0.04
    press_m: float = 0.004

    def __post_init__(self):
        """Refuse an unsafe cell, with the field, its value and the limit."""
        if not 0.0 < self.limits.speed <= HIGHEST_SPEED:
            raise InvalidConfigError(
                f"limits.speed is {self.limits.speed} m/s; it must be above 0 and at most "
                f"{HIGHEST_SPEED}"
            )
        if not (self.hover_m >= 0.0 and self.leg_m > 0.0 and self.press_m >= 0.0):
            raise InvalidConfigError(
                f"hover_m is {self.hover_m}, leg_m {self.leg_m}, press_m {self.press_m}; none may "
                "be negative, and a leg has a length"
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
    """One arm and one fixed camera; `camera` takes a picture now, its pose is in the world."""

    def __init__(self, arm, camera, config, *, may_move=False, clock=time.monotonic):
        """Store arm and camera without moving anything."""
        self._arm, self._camera, self.config = arm, camera, config
        self._may_move, self._clock, self._begun = may_move, clock, clock()
        self._base_turn, self._base_shift = np.split(config.base_from_world[:3], [3], axis=1)

    def observe(self) -> RgbdFrame:
        """Take a picture, regardless of the arm's state."""
        shown = self._camera()
        return RgbdFrame(self._clock() - self._begun, shown.camera, shown.depth_m, shown.color)

    def measured(self):
        """Return the time [s] and the measured position of the tips in the world [m]."""
        here = self._base_turn.T @ (self._arm.position() - self._base_shift[:, 0])
        return self._clock() - self._begun, here

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
        samples, film = [], []
        grasped, error = None, ""

        def stop(*, closed):
            samples.append((*self.measured(), closed))
            film.append(self.observe())

        points = self._points(action)
        try:
            self._arm.open()
            stop(closed=False)
            self._go(points[0])
            for number, leg in enumerate(itertools.pairwise(points)):
                carrying = 1 <= number <= 3
                longest_m = self.config.leg_m if carrying else np.inf
                for point in subdivided(np.stack(leg), longest_m)[1:]:
                    self._go(point)
                    stop(closed=carrying)
                if number == 0:
                    grasped = self._arm.close()
                    stop(closed=True)
                elif number == 3:
                    self._arm.open()
                    stop(closed=False)
        except Exception as failure:
            # Catch every driver error: the arm has stopped, and the operator must know.
            logger.exception("the arm stopped")
            error = f"{type(failure).__name__}: {failure}"
        # Of several samples or pictures at one time the last counts.
        kept = list({one[0]: one for one in samples}.values())
        path = PickerPath(
            np.array([time_s for time_s, _, _ in kept]),
            np.array([tip for _, tip, _ in kept]).reshape(-1, 3),
            np.array([closed for _, _, closed in kept], bool),
        )
        pictures = {frame.time_s: frame for frame in film}
        return Execution(path, tuple(pictures.values()), grasped, error)

    def home(self) -> None:
        """Move straight up and home, where the arm hides nothing; only if motion is allowed."""
        if not self._may_move:
            return
        home = np.array(self.config.home_m)
        _, here = self.measured()
        up = np.array([here[0], here[1], max(here[2], home[2])])
        refusal = self.config.limits.refusal(subdivided(np.stack([up, home]), 0.01))
        if refusal:
            raise InvalidConfigError(f"refused before moving: the way home: {refusal}")
        self._go(up)
        self._go(home)

    def _points(self, action):
        """Return the waypoints, with fingers just below the visible surface, above the table."""
        config = self.config
        lowest = config.limits.table_height_m + config.limits.clearance_m
        # A pick that is already below the limit is left unchanged, so that it is refused.
        pressed = min(action.pick[2], max(action.pick[2] - config.press_m, lowest))
        pick = np.array([action.pick[0], action.pick[1], pressed])
        return waypoints(PickPlace(pick, action.place, action.lift_m), config.hover_m)

    def _go(self, point):
        """Move one leg, after checking the limits again for any caller."""
        self._require_motion()
        refusal = self.config.limits.refusal(point[None])
        if refusal:
            raise InvalidConfigError(f"refused before moving: {refusal}")
        there = self._base_turn @ point + self._base_shift[:, 0]
        self._arm.move(there, self.config.limits.speed)

    def _require_motion(self):
        if not self._may_move:
            raise InvalidConfigError(
                "nothing moves: the robot was made without may_move=True (--move on a command "
                "line); look at a dry run first"
            )


def subdivided(points, longest_m):
    """Return the same path with no leg longer than this [m]."""
    parts = [points[:1]]
    for start, end in itertools.pairwise(points):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / longest_m - 1e-9)))
        parts.append(start + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - start))
    return np.concatenate(parts)


class FrankyArm:
    """An arm through franky-control; the server's version must match the robot's.

    Positions are of the finger tips, in the arm's base frame [m].
    """

    def __init__(self, address, *, speed_share=0.05, force_n=10.0):
        """Connect without moving anything; the share is of the arm's own limits."""
        try:
            import franky
        except ImportError as error:
            raise InvalidConfigError(
                "a Franka arm needs franky-control: pip install franky-control"
            ) from error
        self._franky, self._force_n = franky, force_n
        self._robot, self._gripper = franky.Robot(address), franky.Gripper(address)
        self._robot.relative_dynamics_factor = speed_share

    def position(self):
        """Return the position of the end effector [m]."""
        pose = self._robot.current_cartesian_state.pose.end_effector_pose
        return np.array(pose.translation, dtype=np.float64).reshape(3)

    def move(self, position, speed):
        """Move in a straight line, fingers down, and stop; speed in m/s."""
        franky = self._franky
        self._robot.translation_velocity_limit.set(float(speed))
        target = franky.Affine(position.tolist(), DOWNWARDS)
        self._robot.move(franky.CartesianMotion(target, franky.ReferenceType.Absolute))

    def open(self):
        """Open the fingers wide."""
        self._gripper.open(0.05)

    def close(self):
        """Close the fingers; any width counts as a grasp, because cloth is thin."""
        return bool(self._gripper.grasp(0.0, 0.03, self._force_n, epsilon_outer=0.08))
