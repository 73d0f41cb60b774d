"""A robot in the simulated world (MuJoCo), whose cloth state planning cannot access.

Data that a camera cannot measure are in `true_cloth`, which only scoring and the named control
`perception=truth` use.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.arrays import read_npz, write_npz
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, GarmentKind
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import PickPlace, Workspace
from clothtrack.planning.robots.robot import Execution, MotionLimits, Reachability, RgbdFrame
from clothtrack.recordings.recording import ClothDescription, PickerPath, Table
from clothtrack.simulation.pick_and_place import PlannedAction, carrying_path, free_path
from clothtrack_lab.world.appearance import Appearance
from clothtrack_lab.world.bench import vary
from clothtrack_lab.world.episodes import EpisodeConfig
from clothtrack_lab.world.flex import TIME_STEP_S, USUAL_CONTACT_S, FlexWorld
from clothtrack_lab.world.one_garment import OneGarment
from clothtrack_lab.world.scene import Scene
from clothtrack_lab.world.sensor import Sensor, top_down_camera
from clothtrack_lab.world.template_mesh import SeededGarment, laid_down, random_pose, size_of
from clothtrack_lab.world.tool import Tool

_MOST_DROPS = 5
"""Largest number of times that the cloth is lifted at a random vertex and dropped before an
episode; it stops as soon as the cloth is crumpled."""

_CRUMPLED = 0.65
"""Share of the flat area below which the cloth counts as crumpled."""

_DROP_SPEED = 0.6
"""Speed of the lifted vertex [m/s]."""

_LIFT_SHARE = (0.4, 0.8)
"""Smallest and largest height at which the vertex is released, as a share of that at which the
cloth hangs clear of the table. A towel dropped from 1 ends as a ball that no single pick-and-place
opens: the best of 25 gained 6 % of the flat area."""

Stop = Callable[[RgbdFrame, Float[np.ndarray, " 3"], bool], str]
"""Function of a picture, the tip position [m] and whether the gripper is closed, which returns a
reason to stop, or an empty string."""

_OF_STARTS = 0xF1A7
"""Constant that separates this module's random draws from those of others with the same seed."""


@dataclass(frozen=True)
class SimulatedRobotConfig:
    """The configuration of the robot and its world.

    Attributes:
        episode: configuration of garment, camera, fabric, tool and speeds; drawn from the seed as
            in the benchmark when None.
        film: whether to take pictures throughout an action; otherwise only after it.
        layers: number of layers of cloth that the gripper takes, uppermost first.
        contact_s: time constant of a contact between layers [s], half the usual one (`FlexWorld`),
            because a shirt that passed through itself in its fall is knotted and cannot be
            flattened.
        limits: limits beyond which the robot refuses.
    """

    episode: EpisodeConfig | None = None
    film: bool = True
    layers: int = 1
    contact_s: float = 0.01
    limits: MotionLimits = field(
        default_factory=lambda: MotionLimits(workspace=Workspace((-0.45, 0.45), (-0.4, 0.4)))
    )


class SimulatedRobot:
    """A gripper, a depth camera and a cloth in the simulated world.

    Attributes:
        cloth: information that a person at the table has: kind, color and size.
    """

    def __init__(
        self,
        kind: GarmentKind,
        seed: int,
        config: SimulatedRobotConfig | None = None,
        garment: OneGarment | None = None,
    ) -> None:
        """Place the flat garment on the table; `crumple` then makes the start of an episode."""
        if seed < 0:
            raise InvalidConfigError(f"seed is {seed}; it must be at least 0")
        self.kind: GarmentKind = kind
        self.config = config or SimulatedRobotConfig()
        drawn = vary(kind, seed) if garment is None else garment.config
        self._episode = self.config.episode or drawn
        root = np.random.SeedSequence([_OF_STARTS, seed, list(DEFAULT_SIZES_M).index(kind)])
        of_world, of_sensor, of_start, of_picker = map(np.random.default_rng, root.spawn(4))
        self._of_start, self._of_picker = of_start, of_picker
        episode = self._episode
        cut = garment or SeededGarment(kind, episode.garment, episode.size_m, seed)
        self._flat = cut.flat(vertex_count=episode.vertex_count)
        fabric = episode.fabric or drawn.fabric
        if fabric is None:
            raise InvalidConfigError("episode.fabric is None; give one")
        laid = laid_down(self._flat, random_pose(of_world), fabric.contact_radius_m)
        self._world = FlexWorld(laid, fabric, contact_s=self.config.contact_s)
        camera = top_down_camera(episode.sensor, of_sensor)
        appearance = Appearance.sample(of_sensor)
        tool = episode.tool or Tool.sample(of_sensor)
        self._scene = Scene(self._flat, tool, camera)
        noise = int(of_sensor.integers(1 << 31))
        self._sensor = Sensor(self._scene, episode.sensor, appearance, seed=noise)
        self._pictures = 0
        self._bias = episode.picker_bias_m * of_picker.standard_normal(3)
        self.cloth = ClothDescription(
            kind=kind,
            color=appearance.cloth,
            size_m=size_of(self._flat)
            if episode.garment or garment
            else episode.size_m or DEFAULT_SIZES_M[kind],
        )
        self.table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))

    # The four methods

    def observe(self) -> RgbdFrame:
        """Return a picture without the tool."""
        return self.picture(None)

    def check(self, action: PickPlace) -> Reachability:
        """Return whether the path of the tip is within the limits."""
        path = np.vstack([action.pick, self._carried(action)])
        reason = self.config.limits.refusal(path)
        return Reachability(not reason, reason)

    def execute(
        self, action: PickPlace, *, stop: Stop | None = None, slips_at: float = 1.0
    ) -> Execution:
        """Pick up the cloth at the pick, carry it, release it, and wait until it rests.

        Args:
            stop: function called with every picture on the path, the tip position [m] and whether
                it is closed. If it returns a reason, the gripper opens and retreats from there.
        """
        if not 0.0 <= slips_at <= 1.0:
            raise InvalidConfigError(f"slips_at is {slips_at}; it is a share of the way, 0 to 1")
        reachability = self.check(action)
        if not reachability.reachable:
            raise InvalidConfigError(f"refused before moving: {reachability.reason}")
        episode = self._episode
        way = _Path(self, stop)
        away = self._scene.out_of_picture(action.pick)
        held = self._under(action.pick)
        tip = action.pick.copy()
        if len(held):
            # Move down to the actual cloth, because fingers close on what they touch.
            tip[2] = self._world.positions[held[0], 2]
        way.take(away)
        for point in free_path(away, tip, episode.action)[:-1]:
            way.take(point)
        way.take(tip, closed=True)
        carried = self._carried(replace(action, pick=tip))
        if len(held):
            self._world.grasp(held, tip)
        stride = self._stride
        slips = int(slips_at * len(carried))
        point = tip
        for number, point in enumerate(carried, start=1):
            if number == slips < len(carried):
                self._world.release()
            self._world.move(point)
            self._world.step()
            if number % stride == 0:
                way.take(point, closed=number < len(carried))
            if way.reason:
                break
        self._world.release()
        self._retreat(way, point)
        noise = episode.picker_noise_m * self._of_picker.standard_normal((len(way.tips), 3))
        path = PickerPath(
            np.array(way.times), np.array(way.tips) + self._bias + noise, np.array(way.closed)
        )
        return Execution(path, tuple(way.film), grasped=bool(len(held)), error=way.reason)

    def home(self) -> None:
        """Do nothing, because the tool retreats out of view after every action."""

    # Before an episode

    def crumple(self) -> None:
        """Lift the cloth at a random vertex, move it over the table's middle and release it."""
        episode = self._episode
        self._world.settle(speed=episode.settle_speed, limit_s=episode.settle_limit_s)
        most_area_m2 = _CRUMPLED * projected_area(self._flat.vertices, self._flat.faces)
        for _ in range(_MOST_DROPS):
            positions = self._world.positions
            vertex = int(self._of_start.integers(len(positions)))
            lying = self._flat.vertices
            hangs = float(np.linalg.norm(lying - lying[vertex], axis=1).max())
            start = positions[vertex]
            aside = self._of_start.uniform(-0.03, 0.03, 2)
            share = self._of_start.uniform(*_LIFT_SHARE)
            end = np.array([*aside, share * hangs])
            steps = int(np.linalg.norm(end - start) / (_DROP_SPEED * TIME_STEP_S)) + 1
            self._world.grasp(np.array([vertex]), start)
            for way in np.linspace(0.0, 1.0, steps + 1)[1:]:
                self._world.move(start + way * (end - start))
                self._world.step()
            self._world.release()
            self._world.settle(speed=episode.settle_speed, limit_s=1.0 + episode.settle_limit_s)
            if projected_area(self._world.positions, self._flat.faces) < most_area_m2:
                break

    def save(self, path: Path) -> None:
        """Write the state of the world for resuming, completely or not at all.

        It includes the random state of the camera and the picker, so a resumed episode has the same
        pictures as an uninterrupted one.
        """
        write_npz(
            path,
            {
                "state": self._world.save(),
                "pictures": np.array(self._pictures),
                "contact_s": np.array(self.config.contact_s),
                "noise": np.array(json.dumps(self._noise())),
                "positions": self._world.positions,
                "faces": self._flat.faces,
            },
        )

    def restore(self, path: Path) -> None:
        """Restore a state that `save` wrote for the same garment and seed."""
        try:
            file = read_npz(path)
            state, pictures = file["state"], int(file["pictures"])
            # Worlds without this value were saved before it could be set.
            contact_s = float(file.get("contact_s", USUAL_CONTACT_S))
            # Worlds without noise were saved before the noise was stored.
            noise = json.loads(str(file["noise"])) if "noise" in file else self._noise()
            self._sensor.restore(noise["sensor"])
            self._of_picker.bit_generator.state = noise["picker"]
        except (
            OSError, ValueError, KeyError, TypeError, RecursionError, InvalidResultError,
        ) as error:  # fmt: skip
            raise InvalidResultError(
                f"{path}: not a saved world ({error}); remove the episode and begin again"
            ) from error
        if contact_s != self.config.contact_s:
            raise InvalidConfigError(
                f"{path}: saved with a contact_s of {contact_s}, not {self.config.contact_s}; "
                "choose another folder, or remove this one"
            )
        self._world.restore(state)
        self._pictures = pictures

    def _noise(self) -> dict[str, Any]:
        """Return the states of the generators of camera and picker as plain values."""
        return {"sensor": self._sensor.save(), "picker": self._of_picker.bit_generator.state}

    # What no camera knows

    def true_cloth(self) -> tuple[ClothMesh, Float[np.ndarray, "vertices 3"]]:
        """Return the true garment at rest and its true vertices [m].

        It is only for scoring and the named control.
        """
        return self._flat, self._world.positions

    # Inside

    @property
    def frame_s(self) -> float:
        """Time between two pictures [s]."""
        return 1.0 / self._episode.action.frame_rate

    @property
    def _stride(self) -> int:
        return round(self.frame_s / TIME_STEP_S)

    def _carried(self, action: PickPlace) -> Float[np.ndarray, "steps 3"]:
        planned = PlannedAction(np.zeros(0, np.int64), action.pick, action.place, action.lift_m)
        speed = min(self._episode.action.speed, self.config.limits.speed)
        return carrying_path(planned, replace(self._episode.action, speed=speed), TIME_STEP_S)

    def _under(self, pick: Float[np.ndarray, " 3"]) -> Int[np.ndarray, " held"]:
        """Return the vertices of the uppermost layers of cloth under the tip."""
        positions = self._world.positions
        gap = np.linalg.norm(positions[:, :2] - pick[:2], axis=1)
        column = np.flatnonzero(gap < self._episode.action.grasp_radius_m)
        column = column[np.argsort(-positions[column, 2], kind="stable")]
        held: list[int] = []
        for vertex in column:
            apart = [np.linalg.norm(self._flat.vertices[vertex] - self._flat.vertices[one])
                     for one in held]  # fmt: skip
            if len(held) < self.config.layers and all(one > 0.03 for one in apart):
                held.append(int(vertex))
        return np.array(held, dtype=np.int64)

    def _retreat(self, way: "_Path", tip: Float[np.ndarray, " 3"]) -> None:
        """Retract the tool while the cloth comes to rest; the last picture shows no tool."""
        episode = self._episode
        away = self._scene.out_of_picture(tip)
        path = free_path(tip, away, episode.action)
        limit = int(np.ceil(episode.settle_limit_s / self.frame_s))
        resting = False
        for frame in range(max(len(path), limit)):
            if not resting and frame < limit:
                self._world.step(self._stride)
                resting = self._world.speed_rms < episode.settle_speed
            last = frame >= len(path) - 1 and (resting or frame >= limit - 1)
            way.take(path[min(frame, len(path) - 1)], needed=last)
            if last:
                break

    def tick(self) -> float:
        """Return the time of the camera's next picture [s] and advance to the one after."""
        self._pictures += 1
        return (self._pictures - 1) * self.frame_s

    def picture(self, tip: Float[np.ndarray, " 3"] | None) -> RgbdFrame:
        """Return a picture with the tool's tip at this position [m]; None for no tool."""
        shown = self._sensor.capture(self._world.positions, tip)
        return RgbdFrame(
            self.tick(), self._scene.camera, shown.depth.astype(np.float32), color=shown.color
        )


class _Path:
    """The tip's path during one action, and the pictures taken on it."""

    def __init__(self, robot: SimulatedRobot, stop: Stop | None) -> None:
        self._robot, self._stop = robot, stop
        self.reason = ""
        self.film: list[RgbdFrame] = []
        self.times: list[float] = []
        self.tips: list[Float[np.ndarray, " 3"]] = []
        self.closed: list[bool] = []

    def take(
        self, tip: Float[np.ndarray, " 3"], *, closed: bool = False, needed: bool = False
    ) -> None:
        """Record the tip position, and take a picture if requested."""
        robot = self._robot
        if robot.config.film or needed or not self.film:
            self.film.append(robot.picture(tip))
            self.times.append(self.film[-1].time_s)
            if self._stop is not None:
                self.reason = self.reason or self._stop(self.film[-1], np.array(tip), closed)
        else:
            self.times.append(robot.tick())
        self.tips.append(np.array(tip))
        self.closed.append(closed)
