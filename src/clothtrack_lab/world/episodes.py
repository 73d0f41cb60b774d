"""Recordings of pick-and-places in the simulated world, with the truth in separate files.

`OUT/recordings/NAME/` is a recording like any other. `OUT/truth/NAME.npz` holds data that no camera
can measure, and only evaluation reads it. The recording contains no truth except the first mesh,
which has another triangulation and is misplaced, mis-scaled and noisy, like a first mesh measured
by hand.
"""

import json
import logging
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
from jaxtyping import Float

from clothtrack.files.atomic_write import atomic_file
from clothtrack.files.bounds import Bounds, Checked, Count, NotNegative, Positive, Share
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, GarmentKind
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.recording import ClothDescription, PickerPath, Table
from clothtrack.recordings.store import RecordingWriter
from clothtrack.simulation.pick_and_place import ActionConfig, carrying_path, free_path, plan_action
from clothtrack_lab.world.appearance import Appearance
from clothtrack_lab.world.flex import TIME_STEP_S, Fabric, FlexWorld
from clothtrack_lab.world.scene import Scene
from clothtrack_lab.world.sensor import Sensor, misplaced, top_down_camera
from clothtrack_lab.world.template_mesh import (
    Error,
    GivenGarment,
    SeededGarment,
    TemplateConfig,
    laid_down,
    misjudged,
    random_pose,
    size_of,
)
from clothtrack_lab.world.tool import Tool

logger = logging.getLogger(__name__)

PICKER = "gripper"

_SLIPS_AT = 0.2, 0.8
"""Bounds of the share of the path after which slipping cloth leaves the gripper, drawn
uniformly."""


@dataclass(frozen=True)
class EpisodeConfig(Checked):
    """The configuration of an episode.

    Attributes:
        size_m: width and length of the garment [m]; the usual size of its kind when None.
        garment: file of the garment's template (`clothtrack garment`), which determines size and
            vertices; empty for a garment of usual cut.
        vertex_count: approximate number of vertices of the world's cloth.
        actions: number of pick-and-places.
        settle_speed: rms speed [m/s] of the cloth below which it is at rest.
        settle_limit_s: longest wait for rest after a release [s].
        picker_bias_m: standard deviation, per axis, of the constant error [m] of the tip.
        picker_noise_m: standard deviation, per axis, of its error per sample [m].
        template: configuration of the first mesh, or None for a recording without one.
        action: configuration of drawing pick-and-places.
        sensor: configuration of the camera.
        fabric: material of the cloth; drawn when None.
        tool: tool that moves it; drawn when None.
        reach_across: whether the tool comes to each pick over the middle of the cloth instead of
            from its usual side.
        calibration_error_m: distance of the recorded camera position from the true one, in a random
            direction [m].
        printed: whether the cloth has a print and the color pictures have noise. Depth and motion
            are the same as with the plain cloth.
        slips: share of carries in which the cloth slips out of the gripper, between a fifth and
            four fifths of the path; the recorded path does not show it.
    """

    size_m: tuple[float, float] | None = None
    garment: str = ""
    vertex_count: Count = 1000
    actions: Annotated[int, Bounds(least=1, most=1000)] = 3
    settle_speed: Positive = 0.01
    settle_limit_s: NotNegative = 1.0
    picker_bias_m: Error = 0.0007
    picker_noise_m: Error = 0.0007
    template: TemplateConfig | None = field(default_factory=TemplateConfig)
    action: ActionConfig = field(default_factory=ActionConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    fabric: Fabric | None = None
    tool: Tool | None = None
    reach_across: bool = False
    calibration_error_m: Error = 0.0
    printed: bool = False
    slips: Share = 0.0


SMALL_WORLD = EpisodeConfig(
    size_m=(0.2, 0.2),
    vertex_count=200,
    actions=1,
    template=TemplateConfig(vertex_count=200),
    action=ActionConfig(frame_rate=10.0),
    sensor=SensorConfig(width=320, height=240, focal=300.0),
)
"""One action with a napkin in a few seconds, only for smoke runs and tests."""


def simulate_trajectory(
    kind: GarmentKind,
    seed: int,
    out: Path,
    *,
    config: EpisodeConfig | None = None,
    garment: GivenGarment | None = None,
    name: str | None = None,
    tip_color: str | None = None,
) -> Path:
    """Record a flat garment and random pick-and-places, with the tool away after each."""
    config = config or EpisodeConfig()
    name = name or recording_name(kind, seed, garment)
    root = np.random.SeedSequence([seed, list(DEFAULT_SIZES_M).index(kind)])
    of_world, of_actions, of_sensor, of_template, of_picker, of_calibration, of_slips = map(
        np.random.default_rng, root.spawn(7)
    )
    cut = garment or SeededGarment(kind, config.garment, config.size_m, seed)
    flat = cut.flat(vertex_count=config.vertex_count)
    pose = random_pose(of_world)
    # Draw a fabric even if one is given, so that the other random draws stay the same.
    drawn = Fabric.sample(of_world)
    fabric = config.fabric or drawn
    laid = partial(laid_down, pose=pose, height_m=fabric.contact_radius_m)
    world = FlexWorld(laid(flat), fabric)
    camera, usual_tool = top_down_camera(config.sensor, of_sensor), Tool.sample(of_sensor)
    print_seed = seed if config.printed else None
    appearance = replace(Appearance.sample(of_sensor), tip=tip_color, print_seed=print_seed)
    scene = Scene(flat, config.tool or usual_tool, camera)
    sensor = Sensor(scene, config.sensor, appearance, seed=int(of_sensor.integers(1 << 31)))
    wrong = config.template
    folder = Path(out) / "recordings" / name
    with RecordingWriter(
        folder,
        [misplaced(camera, config.calibration_error_m, of_calibration)],
        {camera.name: config.sensor.step_m},
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])),
        cloth=ClothDescription(
            kind=kind,
            color=appearance.cloth,
            size_m=size_of(flat) if config.garment else config.size_m or DEFAULT_SIZES_M[kind],
            template=None
            if wrong is None
            else misjudged(
                cut.flat(vertex_count=wrong.vertex_count, again=True),
                wrong,
                laid=laid,
                rng=of_template,
            ),
        ),
        provenance=_provenance(seed, config, garment),
    ) as writer:
        film = _Film(world, scene, sensor, writer, config)
        film.run(ClothMesh(world.positions, flat.faces, flat.canonical), of_actions, of_slips)
        writer.set_picker_path(PICKER, film.measured_path(of_picker))
        _write_truth(Path(out) / "truth" / f"{name}.npz", film, flat, fabric)
    logger.info("%s: %d frames, %.2f s simulated", name, len(film.positions), world.time_s)
    return folder


class _Film:
    """A trajectory in progress, which moves the tool, steps the world and takes the pictures."""

    def __init__(
        self,
        world: FlexWorld,
        scene: Scene,
        sensor: Sensor,
        writer: RecordingWriter,
        config: EpisodeConfig,
    ) -> None:
        self._world, self._scene, self._sensor = world, scene, sensor
        self._writer, self._config = writer, config
        self._camera: Camera = scene.camera
        self._steps_per_frame = round(1.0 / (config.action.frame_rate * TIME_STEP_S))
        self.positions: list[Float[np.ndarray, "vertices 3"]] = []
        self.hidden: list[float] = []
        self.missing: list[float] = []
        self.outside: list[float] = []
        self.folded: list[bool] = []
        self.held: list[int] = []
        self.slipped: list[bool] = []
        self._tips: list[Float[np.ndarray, " 3"]] = []
        self.closed: list[bool] = []

    def run(
        self, start: ClothMesh, rng: np.random.Generator, of_slips: np.random.Generator
    ) -> None:
        """Settle the cloth, then record every action; the last frame of each shows no tool."""
        config = self._config
        self._world.settle(speed=config.settle_speed, limit_s=config.settle_limit_s)
        tip = None
        for _ in range(config.actions):
            first = len(self.positions)
            cloth = start.with_vertices(self._world.positions)
            plan = plan_action(cloth, config.action, rng)
            self.folded.append(plan.folded)
            if config.reach_across:
                x, y = (cloth.vertices.mean(axis=0) - plan.pick)[:2]
                self._scene.turn_tool(float(np.arctan2(y, x)))
                tip = None
            if tip is None:
                tip = self._scene.out_of_picture(plan.pick)
                self._take(tip)
            for waypoint in free_path(tip, plan.pick, config.action)[:-1]:
                self._take(waypoint)
            self._take(plan.pick, closed=True)
            self._world.grasp(plan.held, plan.pick)
            path = carrying_path(plan, config.action, TIME_STEP_S)
            lost_at = len(path) + 1
            slips, share = of_slips.random() < config.slips, of_slips.uniform(*_SLIPS_AT)
            if slips:
                lost_at = round(share * len(path))
            self.held.append(len(plan.held))
            self.slipped.append(slips)
            for number, tip in enumerate(path, start=1):
                if number == lost_at:
                    self._world.release()
                self._world.move(tip)
                self._world.step()
                if number % self._steps_per_frame == 0:
                    self._take(tip, closed=number < len(path))
            self._world.release()
            tip = self._retreat(path[-1])
            self._writer.add_action(first, len(self.positions) - 1, [PICKER])

    def _retreat(self, tip: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Retract the tool while the cloth comes to rest; return where the tip ends [m]."""
        config = self._config
        away = self._scene.out_of_picture(tip)
        way = free_path(tip, away, config.action)
        limit = int(np.ceil(config.settle_limit_s * config.action.frame_rate))
        resting = False
        for frame in range(max(len(way), limit)):
            if not resting and frame < limit:
                self._world.step(self._steps_per_frame)
                resting = self._world.speed_rms < config.settle_speed
            self._take(way[min(frame, len(way) - 1)])
            if frame >= len(way) - 1 and resting:
                break
        return away

    def _take(self, tip: Float[np.ndarray, " 3"], *, closed: bool = False) -> None:
        """Take one frame now."""
        vertices = self._world.positions
        picture = self._sensor.capture(vertices, tip)
        self._writer.add_frame(
            len(self.positions) / self._config.action.frame_rate,
            color={self._camera.name: picture.color},
            depth={self._camera.name: picture.depth},
            mask=None,
            cloud=None,
        )
        self.positions.append(vertices.astype(np.float32))
        self.hidden.append(picture.hidden_share)
        self.missing.append(picture.missing_share)
        pixels, _ = self._camera.project(vertices)
        inside = (pixels > -0.5) & (pixels < (self._camera.width - 0.5, self._camera.height - 0.5))
        self.outside.append(1.0 - float(inside.all(axis=1).mean()))
        self._tips.append(np.array(tip))
        self.closed.append(closed)

    def measured_path(self, rng: np.random.Generator) -> PickerPath:
        """Return the tip's path as measured by the robot."""
        config = self._config
        tips = np.array(self._tips)
        bias = config.picker_bias_m * rng.standard_normal(3)
        noise = config.picker_noise_m * rng.standard_normal(tips.shape)
        times = np.arange(len(tips)) / config.action.frame_rate
        return PickerPath(times, tips + bias + noise, np.array(self.closed))


def recording_name(kind: GarmentKind, seed: int, garment: GivenGarment | None) -> str:
    """Return the name of a seed's recording: KIND_SEED, or one with the single garment's label."""
    return f"{kind if garment is None else garment.label}_{seed:04d}"


def _provenance(
    seed: int, config: EpisodeConfig, garment: GivenGarment | None
) -> dict[str, object]:
    """Return the provenance of the recording.

    It has only the physical data that a person at the table could know.
    """
    of_garment = {} if garment is None else {"garment_seed": garment.seed}
    return {
        "source": "simulated world (clothtrack simulate)",
        "physics": f"MuJoCo {mujoco.__version__} flex shell",
        "seed": seed,
        "template": None if config.template is None else asdict(config.template),
        **of_garment,
    }


def _write_truth(path: Path, film: _Film, flat: ClothMesh, fabric: Fabric) -> None:
    """Write the data that the camera could not see, under a temporary name first."""
    with atomic_file(path) as unfinished:
        np.savez_compressed(
            unfinished,
            positions=np.stack(film.positions),
            faces=flat.faces.astype(np.int32),
            canonical=np.asarray(flat.canonical, dtype=np.float64),
            frames=np.arange(len(film.positions)),
            fabric=np.array(json.dumps(asdict(fabric))),
            hidden_by_tool=np.array(film.hidden),
            depth_missing=np.array(film.missing),
            outside_picture=np.array(film.outside),
            gripper_closed=np.array(film.closed),
            picked_folded=np.array(film.folded),
            held_vertices=np.array(film.held),
            slipped=np.array(film.slipped),
        )
