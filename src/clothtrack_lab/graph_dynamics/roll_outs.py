"""Roll-outs of our solver on disk, the training data of the learned mesh dynamics.

    OUT/roll_outs.json        what was asked for
    OUT/shards/0000.npz       roll-outs of one garment, on its coarse mesh

A crumpled garment is rolled out on a fine mesh, all candidates at once. Only the material points of
the coarse mesh are kept, so that the learned dynamics reproduce motion that the coarse mesh's folds
cannot represent.
"""

import json
import logging
import math
import zipfile
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float32, Int

from clothtrack.errors import InvalidConfigError, InvalidResultError, SimulationDivergedError
from clothtrack.files.atomic_write import atomic_file, clear_leftovers, write_file
from clothtrack.files.bounds import Bounds, Checked, Count
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import as_plain, require_same
from clothtrack.files.worker_pool import finished_in_workers, require_workers
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, GarmentKind
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import ActionSpace, SeenCloth, pick_weights, sample_actions
from clothtrack.planning.coarse_cloth import CoarseConfig, Coarsener
from clothtrack.planning.planning_dynamics import HeldPaths, MotionConfig, PlannedCloth
from clothtrack.reconstruction.data.crumpling import Crumpler
from clothtrack.reconstruction.data.garment_draws import (
    GarmentRanges,
    draw_garment,
    draw_parameters,
)
from clothtrack.reconstruction.data.recipes import CrumplingConfig
from clothtrack.reconstruction.data.states import FAST_CONTACT, StatesConfig
from clothtrack.recordings.recording import Table
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment

logger = logging.getLogger(__name__)

LIST_FILE = "roll_outs.json"
_OF_ROLL_OUTS = 0x5017
"""Constant that separates this module's random draws from those of others with the same seed."""


def _of_flattening() -> StatesConfig:
    """Return the configuration of states, mostly heaps, of garments as large as those flattened."""
    shirts_m = 0.38, 0.48
    sizes = GarmentRanges(
        towel_side_m=(0.22, 0.34),
        shirt_length_m=shirts_m,
        long_sleeves=0.0,
        sweaters=0.0,
        robes=0.0,
        open_shirts=0.0,
    )
    crumpling = CrumplingConfig(
        shares={
            "flat": 0.15, "fold": 0.3, "drop": 0.2, "lift": 0.05, "held": 0.1, "push": 0.05,
            "pick_and_place": 0.15,
        },
        after_fold={"fold": 0.5, "pick_and_place": 0.35, "held": 0.1, "push": 0.05},
        pressed=0.0,
        wrinkled=0.0,
    )  # fmt: skip
    return StatesConfig(garments=sizes, crumpling=crumpling)


LEARNED_MESH = CoarseConfig(spacing_m=0.025, most_vertices=400)
"""Coarse mesh of the learned dynamics; the reference code clusters to the same spacing."""


@dataclass(frozen=True)
class RollOutConfig(Checked):
    """The configuration of roll-outs.

    Attributes:
        vertex_count: approximate number of vertices of the simulated garment.
        starts: number of crumpled states per garment, and so per shard.
        actions: number of actions tried from each of them.
        frame_s: time between two kept moments [s]; the reference's model has steps of 0.05.
        coarse: mesh whose vertices are kept.
        motion: motion of the tip.
        space: actions to try.
        states: configuration of making and crumpling garments.
    """

    vertex_count: int = 600
    starts: Count = 5
    actions: Annotated[int, Bounds(least=1, most=1000)] = 10
    frame_s: float = 0.05
    coarse: CoarseConfig = LEARNED_MESH
    motion: MotionConfig = field(
        default_factory=lambda: MotionConfig(time_step_s=0.025, rest_s=0.4)
    )
    space: ActionSpace = field(default_factory=lambda: ActionSpace(distance_m=(0.05, 0.25)))
    states: StatesConfig = field(default_factory=_of_flattening)

    def __post_init__(self) -> None:
        """Refuse a configuration that cannot be made.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        ratio = self.frame_s / self.motion.time_step_s
        if ratio < 1.0 or abs(ratio - round(ratio)) > 1e-9:
            raise InvalidConfigError(
                f"frame_s is {self.frame_s}; it must be a multiple of motion.time_step_s "
                f"({self.motion.time_step_s})"
            )


@dataclass(frozen=True, eq=False)
class RollOutShard:
    """Roll-outs of one garment.

    Attributes:
        mesh: coarse garment at rest [m].
        positions: its vertices at every kept moment [m], the first before the motion.
        held_frames: number of moments for which it is held, the first excluded.
        frame_s: time between two moments [s].
    """

    mesh: ClothMesh
    positions: Float32[np.ndarray, "roll_outs frames vertices 3"]
    held: Int[np.ndarray, " roll_outs"]
    held_frames: Int[np.ndarray, " roll_outs"]
    frame_s: float

    def every(self, step_s: float) -> "RollOutShard":
        """Return the roll-outs with one moment kept per `step_s`.

        The vertex counts as held until the first kept moment after its release.
        """
        stride = frames_per_step(step_s, self.frame_s)
        return replace(
            self,
            positions=self.positions[:, ::stride],
            held_frames=-(-self.held_frames // stride),
            frame_s=step_s,
        )


def frames_per_step(step_s: float, frame_s: float) -> int:
    """Return the number of kept moments of roll-outs per step of a model."""
    stride = round(step_s / frame_s)
    if stride < 1 or abs(stride * frame_s - step_s) > 1e-9:
        raise InvalidConfigError(
            f"step_s is {step_s}, and the roll-outs have a moment every {frame_s} s; give a "
            "multiple of that"
        )
    return stride


def generate_roll_outs(
    out: Path,
    kind: GarmentKind,
    count: int,
    *,
    seed: int = 0,
    config: RollOutConfig | None = None,
    processes: int = 1,
    progress: Progress | None = None,
) -> list[Path]:
    """Make at least `count` roll-outs, in whole shards; finished ones are kept."""
    require_workers(processes)
    if count < 1:
        raise InvalidConfigError(f"the number of roll-outs is {count}; give at least 1")
    config = config or RollOutConfig()
    shards = math.ceil(count / (config.starts * config.actions))
    listed, asked = out / LIST_FILE, {"kind": kind, "seed": seed, "config": asdict(config)}
    if not listed.exists():
        write_file(listed, json.dumps(as_plain(asked), indent=1).encode())
    require_same(listed, json.loads(listed.read_bytes()), asked)
    paths = [out / "shards" / f"{number:04d}.npz" for number in range(shards)]
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    work = partial(_make_and_write, out=out, kind=kind, seed=seed, config=config)
    done = shards - len(missing)
    if progress is not None:
        progress(f"{kind}: {done}/{shards} shards of roll-outs", done, shards)
    try:
        with closing(finished_in_workers(work, missing, processes)) as results:
            for _ in results:
                done += 1
                if progress is not None:
                    progress(f"{kind}: {done}/{shards} shards of roll-outs", done, shards)
    finally:
        clear_leftovers(paths)
    return paths


def make_roll_outs(
    kind: GarmentKind, number: int, seed: int, config: RollOutConfig
) -> RollOutShard:
    """Return shard `number`, which depends only on the seed and the number."""
    rng = np.random.default_rng([_OF_ROLL_OUTS, seed, number, list(DEFAULT_SIZES_M).index(kind)])
    states = replace(config.states, vertex_count=config.vertex_count)
    fine = draw_garment(kind, states.garments, states.vertex_count, rng)
    coarsen = Coarsener(fine, kind, config.coarse)
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    solver_config = replace(FAST_CONTACT, table=table)
    crumpler = Crumpler(fine, states.crumpling, solver_config)
    parts: list[tuple[np.ndarray, HeldPaths]] = []
    while len(parts) < config.starts:
        parameters = draw_parameters(states.cloth, rng)
        begun = len(parts)
        for state in crumpler.episode(parameters, rng.spawn(1)[0]):
            if state.exploded or len(parts) == config.starts:
                break
            solver = ClothSolver(
                fine, solver_config, parameters=parameters, environments=config.actions
            )
            solver.step(0.01)
            parts.append(_rolled(solver, coarsen, state.positions, config, rng))
        if len(parts) == begun and rng.random() < 0.05:
            raise SimulationDivergedError(
                f"roll-outs of shard {number}: crumpled cloth explodes again and again; "
                "narrow the ranges of states.cloth"
            )
    return _joined(parts, coarsen.flat, config)


def _rolled(
    solver: ClothSolver,
    coarsen: Coarsener,
    start: Float32[np.ndarray, "vertices 3"],
    config: RollOutConfig,
    rng: np.random.Generator,
) -> tuple[np.ndarray, HeldPaths]:
    """Return the coarse vertices at every kept moment of all actions from one crumpled state."""
    fine, coarse = solver.mesh, coarsen(start)
    cloth = PlannedCloth(coarsen.flat, coarse)
    flat_on_table = coarse * [1.0, 1.0, 0.0]
    seen = SeenCloth(coarse, None)
    weights = pick_weights(flat_on_table, coarsen.flat, flat_on_table)
    actions = sample_actions(seen, config.actions, config.space, rng, weights=weights)
    held = HeldPaths.of(cloth, [*actions, *[None] * (config.actions - len(actions))], config.motion)
    every = np.arange(config.actions)
    # The gripper takes the fine vertex nearest to the coarse one.
    gaps = np.linalg.norm(start[None] - coarse[held.vertices][:, None], axis=2)
    taken = np.argmin(gaps, axis=1)
    offset = start[taken] - coarse[held.vertices]
    solver.place(start)
    solver.set_velocities(np.zeros_like(start))
    targets = np.zeros((config.actions, fine.vertex_count, 3))
    strength = np.zeros(targets.shape[:2])
    stride = round(config.frame_s / config.motion.time_step_s)
    # Every candidate is released at a kept moment.
    let_go = stride * np.ceil(held.steps / stride).astype(int)
    total = int(let_go.max()) + stride * math.ceil(config.motion.rest_s / config.frame_s)
    kept = [np.stack([coarsen(one) for one in solver.positions])]
    for step in range(total):
        strength[every, taken] = (step < let_go) & (held.vertices >= 0)
        if held.targets.shape[1]:
            targets[every, taken] = held.targets[:, min(step, held.targets.shape[1] - 1)] + offset
        solver.step(config.motion.time_step_s, Attachment(targets, strength))
        if (step + 1) % stride == 0:
            kept.append(np.stack([coarsen(one) for one in solver.positions]))
    frames = np.stack(kept, axis=1).astype(np.float32)
    return frames, replace(held, steps=let_go // stride)


def _joined(
    parts: list[tuple[np.ndarray, HeldPaths]], mesh: ClothMesh, config: RollOutConfig
) -> RollOutShard:
    """Return one shard; shorter roll-outs are padded with their last moment."""
    longest = max(frames.shape[1] for frames, _ in parts)
    padded = [
        np.concatenate([frames, np.repeat(frames[:, -1:], longest - frames.shape[1], axis=1)], 1)
        for frames, _ in parts
    ]
    positions = np.concatenate(padded)
    held = np.concatenate([ways.vertices for _, ways in parts])
    steps = np.concatenate([ways.steps for _, ways in parts])
    sound = np.isfinite(positions).all(axis=(1, 2, 3))
    if sound.sum() < 0.5 * len(sound):
        raise SimulationDivergedError(
            f"only {int(sound.sum())} of {len(sound)} roll-outs stayed finite; narrow the "
            "ranges of states.cloth"
        )
    return RollOutShard(
        mesh, positions[sound], held[sound], np.where(held[sound] < 0, 0, steps[sound]),
        config.frame_s,
    )  # fmt: skip


def _write_roll_outs(shard: RollOutShard, path: Path) -> None:
    """Write a shard, completely or not at all."""
    with atomic_file(path) as unfinished:
        np.savez_compressed(
            unfinished,
            flat=shard.mesh.vertices,
            faces=shard.mesh.faces,
            positions=shard.positions,
            held=shard.held,
            held_frames=shard.held_frames,
            frame_s=np.array(shard.frame_s),
        )


def read_roll_outs(path: Path) -> RollOutShard:
    """Read a shard; no code in it is executed."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return RollOutShard(
                ClothMesh(file["flat"], file["faces"]),
                file["positions"],
                file["held"],
                file["held_frames"],
                float(file["frame_s"]),
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidResultError(
            f"{path}: not a shard of roll-outs ({error}); remove it and make it again"
        ) from error


def _make_and_write(
    number: int, *, out: Path, kind: GarmentKind, seed: int, config: RollOutConfig
) -> int:
    shard = make_roll_outs(kind, number, seed, config)
    _write_roll_outs(shard, out / "shards" / f"{number:04d}.npz")
    return number
