"""Generates labeled states of garments, the training data of a reconstruction network.

`OUT/shards/0000.zarr` holds all states of one garment. Garments differ in width, length and
material. Shard k depends only on the seed and on k. A finished shard is kept, so an interrupted run
resumes where it stopped.
"""

import logging
import math
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float32

from clothtrack.errors import InvalidConfigError, InvalidResultError, SimulationDivergedError
from clothtrack.files.atomic_write import atomic_file
from clothtrack.files.bounds import Bounds, Checked, Count
from clothtrack.files.many_items import attempts, results_of
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import as_plain, made_with, require_same
from clothtrack.files.worker_pool import require_workers
from clothtrack.garments.garment_meshes import ClothKind
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.quality import crossings, edge_strain
from clothtrack.reconstruction.data.crumpling import CrumpledState, Crumpler
from clothtrack.reconstruction.data.folding import NEAT
from clothtrack.reconstruction.data.garment_draws import (
    BEND_LENGTH_M,
    KINDS,
    ClothRanges,
    GarmentRanges,
    draw_garment,
    draw_parameters,
)
from clothtrack.reconstruction.data.recipes import REFERENCE_SIZE_M, CrumplingConfig
from clothtrack.reconstruction.data.state_store import (
    LIST_FILE,
    SHARD_FOLDER,
    StateSet,
    StateShard,
    open_states,
    read_list,
    read_shard,
    shard_path,
    write_list,
    write_shard,
)
from clothtrack.reconstruction.data.states_card import dataset_card
from clothtrack.simulation.parameters import SolverConfig

logger = logging.getLogger(__name__)

_CARD_FILE = "README.md"

PACKAGES = ("numpy", "scipy", "warp-lang", "zarr")
"""Packages that states depend on."""


_OF_STATES = 0x57A7E
"""Seed component that separates this module's draws from those of others with the same seed."""


_GARMENTS_TRIED = 4
"""Number of garments that are tried for a shard before it fails."""


_THICKEST_M = 0.008
"""Largest distance that layers keep in the solver [m]."""

_THICKEST = 0.015
"""Largest thickness of cloth over the garment's size."""


FAST_CONTACT = SolverConfig(
    edge_contact=False,
    rebuild_s=0.0033,
    contact_margin_m=0.004,
    contact_depth_m=0.01,
    speed_limit=2.0,
    damping=4.0,
)
"""Solver settings for whole crumpled cloths; thickness and density are set per cloth.

Edge contact takes five times as long on crumpled cloth. Without it, searching for contacts three
times as often, a wider margin and a lower speed limit keep crossings to a few per 1,000 edges.
"""


@dataclass(frozen=True)
class StatesConfig(Checked):
    """Settings of the generated states.

    Attributes:
        vertex_count: approximate vertex count of a garment.
        episodes: number of episodes per garment, and so per shard.
        shift_m: largest distance of a finished state from the origin, along x and along y [m].
        crossings_limit: share of edges that pass through a triangle, above which a state and the
            rest of its episode are dropped.
        folded_crossings_limit: the same for neat folds, whose layers meet in creases that are
            narrower than an edge.
        crumpling: settings of the episodes.
        garments: sizes and cuts of garments.
        cloth: materials of garments.
    """

    vertex_count: Annotated[int, Bounds(least=50)] = 1000
    episodes: Count = 5
    shift_m: float = 0.03
    crossings_limit: float = 0.03
    folded_crossings_limit: float = 0.06
    crumpling: CrumplingConfig = field(default_factory=CrumplingConfig)
    garments: GarmentRanges = field(default_factory=GarmentRanges)
    cloth: ClothRanges = field(default_factory=ClothRanges)

    def __post_init__(self) -> None:
        """Reject invalid settings.

        Raises:
            InvalidConfigError: a field is out of bounds; states the field, its value and the limit.
        """
        super().__post_init__()
        crumpling = self.crumpling
        if (
            crumpling.states < 1
            or min(sum(crumpling.shares.values()), sum(crumpling.next_shares.values())) <= 0.0
        ):
            raise InvalidConfigError(
                "crumpling.states must be at least 1, and one of crumpling.shares and of "
                "crumpling.next_shares above 0"
            )
        kinds = {name: getattr(self.crumpling, name) for name in ("folded", "middle", "pulled")}
        if min(kinds.values()) < 0.0 or sum(kinds.values()) > 1.0:
            text = ", ".join(f"crumpling.{name} {share:g}" for name, share in kinds.items())
            raise InvalidConfigError(f"{text}: none may be below 0, nor their sum above 1")

    @property
    def shard_states(self) -> int:
        """Number of states in a shard."""
        return self.episodes * self.crumpling.states


def generate_states(
    out: Path,
    kind: ClothKind,
    states: int,
    *,
    seed: int = 0,
    config: StatesConfig | None = None,
    processes: int = 1,
    progress: Progress | None = None,
    ray: str = "",
) -> StateSet:
    """Make at least the given number of states, in whole shards."""
    require_workers(processes)
    if states < 1:
        raise InvalidConfigError(f"the number of states is {states}; give at least 1")
    out, config = Path(out), config or StatesConfig()
    count = math.ceil(states / config.shard_states)
    made = attempts(
        _Making(out, kind, seed, config), range(count), kind="garments", workers=processes,
        ray=ray, progress=progress,
    )  # fmt: skip
    with locked_output(out):
        document = _document(out, kind, seed, config)
        write_list(out, document)
        with closing(made) as tries:
            for number, entry in results_of(tries):
                name = shard_path(out, number).name
                # A kept shard is already listed with its CPU time, unless a process was killed
                # between writing the shard and the list.
                if entry["cpu_s"] is not None or name not in document["shards"]:
                    document["shards"] = dict(sorted({**document["shards"], name: entry}.items()))
                    write_list(out, document)
        found = open_states(out)
        with atomic_file(out / _CARD_FILE) as unfinished:
            unfinished.write_text(dataset_card(found), encoding="utf-8")
    return found


@dataclass(frozen=True)
class _Making:
    """Make a shard, as `clothtrack.files.many_items.Work`."""

    out: Path
    kind: ClothKind
    seed: int
    config: StatesConfig

    def name(self, number: int) -> str:
        """Return the name of the shard."""
        return shard_path(self.out, number).name

    def paths(self, number: int) -> list[Path]:
        """Return the path of the shard."""
        return [shard_path(self.out, number)]

    def kept(self, number: int) -> dict[str, Any] | None:
        """Return the entry of an intact shard, without the CPU time."""
        path = shard_path(self.out, number)
        if not path.exists():
            return None
        try:
            shard = read_shard(path)
        except InvalidResultError as error:
            logger.warning("made again: %s", error)
            return None
        return {"states": len(shard.positions), "cpu_s": None}

    def do(self, number: int) -> dict[str, Any]:
        """Make and write the shard, and return its entry in the list."""
        start = time.process_time()
        shard = make_shard(self.kind, number, self.seed, self.config)
        write_shard(shard, shard_path(self.out, number))
        cpu_s = round(time.process_time() - start, 2)
        return {"states": len(shard.positions), "cpu_s": cpu_s}


def make_shard(kind: ClothKind, number: int, seed: int, config: StatesConfig) -> StateShard:
    """Return shard `number`, the states of one garment.

    An episode ends early when the cloth explodes or has too many self-intersections. More episodes
    are started until the shard has all its states. A garment that does not reach that number is
    replaced by another one.
    """
    rng = np.random.default_rng([_OF_STATES, seed, number, KINDS.index(kind)])
    for _ in range(_GARMENTS_TRIED - 1):
        try:
            return _shard(kind, seed, config, rng)
        except SimulationDivergedError as error:
            logger.warning("shard %d: %s; another garment is drawn", number, error)
    return _shard(kind, seed, config, rng)


def _shard(
    kind: ClothKind, seed: int, config: StatesConfig, rng: np.random.Generator
) -> StateShard:
    """Return the states of the garment that is drawn next."""
    mesh = draw_garment(kind, config.garments, config.vertex_count, rng)
    size_m = float(np.ptp(mesh.vertices[:, :2], axis=0).max())
    thickness = float(np.exp(rng.uniform(*np.log(config.cloth.thickness_m))))
    thickness = min(thickness, _THICKEST * size_m)
    contact = float(rng.uniform(*config.cloth.contact_m))
    contact = max(thickness, contact * max(1.0, math.sqrt(size_m / REFERENCE_SIZE_M)))
    density = float(rng.uniform(*config.cloth.area_density))
    solver = replace(FAST_CONTACT, thickness_m=min(_THICKEST_M, contact), area_density=density)
    crumpler = Crumpler(mesh, config.crumpling, solver, thickness_m=thickness)
    flat_area = projected_area(mesh.vertices, mesh.faces)
    taken: list[CrumpledState] = []
    episodes: list[int] = []
    measures: dict[str, list[float]] = {
        "speed": [], "strain": [], "coverage": [], "crossings": []
    }  # fmt: skip
    for episode, state, crossed in _sound_states(crumpler, config, rng):
        taken.append(state)
        episodes.append(episode)
        measures["speed"].append(state.speed)
        measures["strain"].append(edge_strain(mesh, state.positions))
        measures["coverage"].append(projected_area(state.positions, mesh.faces) / flat_area)
        measures["crossings"].append(crossed)
    return StateShard(
        kind=kind,
        mesh=mesh,
        positions=np.stack([_near_origin(one.positions, config.shift_m, rng) for one in taken]),
        episodes=np.array(episodes, dtype=np.int32),
        recipes=tuple(one.recipe for one in taken),
        seed=seed,
        measures={name: np.array(values) for name, values in measures.items()},
    )


def _sound_states(
    crumpler: Crumpler, config: StatesConfig, rng: np.random.Generator
) -> Iterator[tuple[int, CrumpledState, int]]:
    """Iterate over the states of a shard, with episode and number of crossing edges."""
    wanted, found = config.shard_states, 0
    limit = config.crossings_limit * len(crumpler.mesh.edges)
    folded_limit = config.folded_crossings_limit * len(crumpler.mesh.edges)
    edge_m = float(np.mean(crumpler.mesh.edge_lengths))
    for episode in range(4 * config.episodes):
        parameters = draw_parameters(config.cloth, rng)
        parameters = replace(
            parameters,
            bend_compliance=parameters.bend_compliance * (edge_m / BEND_LENGTH_M) ** 2,
        )
        for state in crumpler.episode(parameters, rng.spawn(1)[0]):
            if state.exploded:
                logger.info("episode %d: %s exploded", episode, state.recipe)
                break
            crossed = crossings(state.positions, crumpler.mesh.faces)
            if crossed > (folded_limit if state.recipe in NEAT else limit):
                logger.info("episode %d: %s: %d edges cross", episode, state.recipe, crossed)
                break
            yield episode, state, crossed
            found += 1
            if found == wanted:
                return
    raise SimulationDivergedError(
        f"only {found} of {wanted} states of a {len(crumpler.mesh.vertices)}-vertex garment were "
        "sound; use a shorter solver.substep_s, a thicker cloth or a higher crossings_limit"
    )


def _near_origin(
    positions: Float32[np.ndarray, "vertices 3"], shift_m: float, rng: np.random.Generator
) -> Float32[np.ndarray, "vertices 3"]:
    """Return the state turned randomly about the vertical and moved near the origin [m]."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = positions.astype(np.float64)
    moved[:, :2] = moved[:, :2] @ turn.T
    middle = 0.5 * (moved[:, :2].min(axis=0) + moved[:, :2].max(axis=0))
    moved[:, :2] += rng.uniform(-shift_m, shift_m, 2) - middle
    return moved.astype(np.float32)


def _document(out: Path, kind: ClothKind, seed: int, config: StatesConfig) -> dict[str, Any]:
    """Return the list of a folder, read or new."""
    asked = as_plain({"kind": kind, "seed": seed, "config": asdict(config)})
    found = read_list(out)
    if found is None:
        if (out / SHARD_FOLDER).exists() and any((out / SHARD_FOLDER).glob("[0-9]*.zarr")):
            raise InvalidConfigError(
                f"{out / SHARD_FOLDER} holds shards, but {out / LIST_FILE} is missing; choose "
                "another folder"
            )
        return {**asked, "provenance": made_with(PACKAGES), "shards": {}}
    require_same(out / LIST_FILE, {name: found.get(name) for name in asked}, asked)
    return {"shards": {}, **found}
