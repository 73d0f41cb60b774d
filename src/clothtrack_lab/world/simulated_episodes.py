"""Flattening episodes in the simulated world, with one crumpled start per seed for all methods.

    OUT/episodes/NAME/        the episode (`EpisodeStore`)
    OUT/recordings/NAME/      the same as one normal recording
    OUT/truth/NAME.npz        true vertices at the first and last frame of every action
    OUT/worlds/NAME/00.npz    the world after every step, to go on from

The truth is stored separately, and no tracking code reads it.
"""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import atomic_file
from clothtrack.files.progress import Progress
from clothtrack.garments.garment_meshes import GarmentKind
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.episode_store import EpisodeStore
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
from clothtrack.planning.flattening import EpisodeScene, Flattening, Propose, Watch
from clothtrack.planning.perception import Perception, perception_of
from clothtrack.planning.planning_dynamics import PlanningDynamics
from clothtrack.recordings.store import read_recording
from clothtrack_lab.world.one_garment import OneGarment
from clothtrack_lab.world.simulated_robot import SimulatedRobot, SimulatedRobotConfig

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SimulatedEpisode:
    """The identification of an episode.

    Attributes:
        garment_seed: seed of the garment (`OneGarment`), the same for every episode; None if each
            `seed` has its own garment.
    """

    kind: GarmentKind
    seed: int
    garment_seed: int | None = None

    @property
    def garment(self) -> OneGarment | None:
        """Garment that does not depend on the episode's seed, if any."""
        return None if self.garment_seed is None else OneGarment(self.kind, self.garment_seed)

    @property
    def label(self) -> str:
        """Name of the episode and of its crumpled start: KIND_SEED, or KIND_gGARMENT_SEED."""
        return f"{self.garment.label if self.garment else self.kind}_{self.seed:04d}"


@dataclass(frozen=True, eq=False)
class EpisodeParts:
    """The parts shared by several episodes, so that networks are loaded once.

    Attributes:
        perception: perception of the cloth; made from the configuration when None.
        dynamics: dynamics of the planner; made from the configuration when None.
        starts: folder of crumpled starts, shared by all methods of flattening.
    """

    perception: Perception | None = None
    dynamics: PlanningDynamics | None = None
    starts: Path | None = None
    propose: Propose | None = None


def flatten_simulated(
    out: Path,
    episode: SimulatedEpisode,
    config: FlattenConfig,
    *,
    robot_config: SimulatedRobotConfig | None = None,
    parts: EpisodeParts | None = None,
    device: str = "cpu",
    watch: Watch | None = None,
    progress: Progress | None = None,
) -> EpisodeStore:
    """Flatten one crumpled garment in the simulated world; a finished episode is left unchanged."""
    parts = parts or EpisodeParts()
    name = episode.label
    robot = SimulatedRobot(episode.kind, episode.seed, robot_config, episode.garment)
    dynamics, perception = parts.dynamics, parts.perception
    # Refuse unreadable weights before anything is written.
    if config.policy == "planned":
        dynamics = dynamics or dynamics_of(config, device=device)
        # A control reads this robot's truth, so it cannot be shared.
        if config.perception.name == "truth" or perception is None:
            perception = perception_of(
                episode.kind, config.perception, true_cloth=robot.true_cloth, device=device
            )
    worlds = _Worlds(robot, out / "worlds" / name)
    if not (out / "episodes" / name / "episode.json").exists():
        if progress is not None:
            progress("crumple the cloth", 0, 0)
        start = (parts.starts or out / "starts") / f"{episode.label}.npz"
        begin(robot, start)
    flat, _ = robot.true_cloth()
    flat_area_m2 = projected_area(flat.vertices, flat.faces)

    def score() -> float:
        mesh, positions = robot.true_cloth()
        return projected_area(positions, mesh.faces)

    flattening = Flattening(
        robot,
        EpisodeScene(robot.cloth, robot.table, flat_area_m2),
        config,
        perception=perception,
        dynamics=dynamics,
        propose=parts.propose,
        seed=episode.seed,
        score=score,
        checkpoint=worlds,
    )
    store = flattening.run(out / "episodes" / name, watch=watch, progress=progress)
    label = store.document["asked"]["label"]
    stamp = {"source": "simulated world (clothtrack flatten)", "seed": episode.seed, **label}
    if episode.garment_seed is not None:
        stamp["garment_seed"] = episode.garment_seed
    store.joined(out / "recordings" / name, stamp)
    _write_truth(out / "truth" / f"{name}.npz", robot, store, worlds)
    return store


def shared_parts(
    kind: GarmentKind, config: FlattenConfig, *, starts: Path | None = None, device: str = "cpu"
) -> EpisodeParts:
    """Return the parts that episodes of one garment can share; refuse unreadable weights."""
    if config.policy != "planned":
        return EpisodeParts(starts=starts)
    perception = None
    if config.perception.name != "truth":
        perception = perception_of(kind, config.perception, device=device)
    return EpisodeParts(perception, dynamics_of(config, device=device), starts)


def knowing_the_garment(
    config: FlattenConfig, garment: OneGarment | None, out: Path
) -> FlattenConfig:
    """Return the configuration with the garment's template, written into `out/garments`.

    This corresponds to measuring a garment once (`clothtrack garment`). Without a garment, nothing
    is written or changed.
    """
    require_one_garment(config, garment)
    if garment is None:
        return config
    template = str(garment.write_template(out / "garments"))
    return replace(config, perception=replace(config.perception, template=template))


def require_one_garment(config: FlattenConfig, garment: OneGarment | None) -> None:
    """Refuse a garment seed together with a template."""
    if garment is not None and config.perception.template:
        raise InvalidConfigError(
            f"garment_seed {garment.seed} draws a garment of its own cut and size; leave the "
            f"template {config.perception.template} out"
        )


def begin(robot: SimulatedRobot, start: Path) -> None:
    """Crumple the robot's cloth to the same start for every method."""
    if start.exists():
        robot.restore(start)
        return
    robot.crumple()
    robot.save(start)
    # Restore from the file, as in every other run.
    robot.restore(start)


class _Worlds:
    """The world after every step, on disk."""

    def __init__(self, robot: SimulatedRobot, folder: Path) -> None:
        self._robot, self.folder = robot, folder

    def save(self, step: int) -> None:
        """Save the world after a step."""
        self._robot.save(self.folder / f"{step:02d}.npz")

    def restore(self, step: int) -> None:
        """Restore the world after a step."""
        self._robot.restore(self.folder / f"{step:02d}.npz")

    def positions(self, step: int) -> np.ndarray:
        """Return true vertices after a step [m]."""
        with np.load(self.folder / f"{step:02d}.npz", allow_pickle=False) as file:
            return file["positions"]


def _write_truth(path: Path, robot: SimulatedRobot, store: EpisodeStore, worlds: _Worlds) -> None:
    """Write the true vertices at the end of every step, by frames of the joined recording."""
    if path.exists():
        return
    flat, _ = robot.true_cloth()
    frames, total = [], 0
    for step in range(len(store.steps)):
        total += len(read_recording(store.recording_path(step)).frames)
        frames.append(total - 1)
    positions = np.stack([worlds.positions(step) for step in range(len(frames))])
    with atomic_file(path) as unfinished:
        np.savez_compressed(
            unfinished,
            positions=positions.astype(np.float32),
            faces=flat.faces.astype(np.int32),
            canonical=np.asarray(flat.canonical, dtype=np.float64),
            frames=np.array(frames),
        )
