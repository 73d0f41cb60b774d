"""Generates labeled states of garments: what a reconstruction network learns from.

`OUT/shards/0000.zarr` holds all states of one garment; garments differ in width and length, and in
what they are made of. Shard k depends on the seed and on k alone. A finished shard is kept, so an
interrupted run goes on where it stopped.
"""

import logging
import math
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from clothtrack.errors import InvalidConfigError, InvalidResultError, SimulationDivergedError
from clothtrack.files.atomic_write import atomic_file
from clothtrack.files.bounds import Checked, Count
from clothtrack.files.many_items import attempts, results_of
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import made_with
from clothtrack.files.run_manifest import as_plain, require_same
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
"""What states depend on."""


_OF_STATES = 0x57A7E
"""Keeps the draws of this module apart from those of others with the same seed."""


_GARMENTS_TRIED = 4
"""So many garments are drawn for a shard, one after the other, before its settings are blamed."""


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
"""The solver for whole crumpled cloths; thickness and density are those of each cloth.

Contact between edges costs five times as much on crumpled cloth. Searching thrice as often, a
wider margin and a lower speed limit keep crossings to a few per 1,000 edges without it.
"""


@dataclass(frozen=True)
class StatesConfig(Checked):
    """What states are made, and how.

    Attributes:
        vertex_count: about how many vertices a garment has.
        episodes: episodes per garment, and so per shard.
        shift_m: a finished state lies this far from the origin at most, along x and along y [m].
        crossings_limit: states in which more than this share of the edges passes through a
            triangle are left out, and what would have followed from them.
        folded_crossings_limit: the same for neat folds, whose layers meet in creases that are
            narrower than an edge.
        crumpling: the episodes.
        garments: how large they are, and how they are cut.
        cloth: what they are made of.
    """

    vertex_count: Count = 1000
    episodes: Count = 5
    shift_m: float = 0.03
    crossings_limit: float = 0.03
    folded_crossings_limit: float = 0.06
    crumpling: CrumplingConfig = field(default_factory=CrumplingConfig)
    garments: GarmentRanges = field(default_factory=GarmentRanges)
    cloth: ClothRanges = field(default_factory=ClothRanges)

    def __post_init__(self) -> None:
        """Refuse what cannot be made.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
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
        """States in a shard."""
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
    """Make at least so many states: as many whole shards as that takes.

    Args:
        out: folder for `shards/`, `states.json` and the dataset card.
        kind: the garment.
        states: how many are wanted.
        seed: of everything.
        config: what is made, and how.
        processes: worker processes.
        progress: called first, and after each shard, kept ones included.
        ray: address of Ray, which is to do it; worker processes by default.

    Raises:
        InvalidConfigError: there are no workers or states, another run writes to `out`, or it
            holds states that were made with another seed, kind or settings.
        SimulationDivergedError: of several garments in turn too few states are sound.
        StorageError: the disk refuses.
    """
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
                # A kept shard is listed already, with the time that it took, unless a process was
                # killed between the shard and the list.
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
        """The shard's own name."""
        return shard_path(self.out, number).name

    def paths(self, number: int) -> list[Path]:
        """The shard."""
        return [shard_path(self.out, number)]

    def kept(self, number: int) -> dict[str, Any] | None:
        """The entry of a shard that is whole, without the CPU time."""
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
        """Make the shard and write it; its entry in the list."""
        start = time.process_time()
        shard = make_shard(self.kind, number, self.seed, self.config)
        write_shard(shard, shard_path(self.out, number))
        cpu_s = round(time.process_time() - start, 2)
        return {"states": len(shard.positions), "cpu_s": cpu_s}


def make_shard(kind: ClothKind, number: int, seed: int, config: StatesConfig) -> StateShard:
    """Shard `number`: the states of one garment.

    An episode ends early when the cloth explodes or passes through itself too much; more
    episodes are begun until the shard has all its states. A garment that does not come to so many
    is given up for another one.

    Raises:
        SimulationDivergedError: `_GARMENTS_TRIED` garments were given up.
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
    """The states of the garment that is drawn next.

    Raises:
        SimulationDivergedError: too few states are sound.
    """
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
    """As many states as a shard has, each with its episode and how many edges cross something."""
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
    """The same state, turned about the vertical at random and moved to the origin [m]."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = positions.astype(np.float64)
    moved[:, :2] = moved[:, :2] @ turn.T
    middle = 0.5 * (moved[:, :2].min(axis=0) + moved[:, :2].max(axis=0))
    moved[:, :2] += rng.uniform(-shift_m, shift_m, 2) - middle
    return moved.astype(np.float32)


def _document(out: Path, kind: ClothKind, seed: int, config: StatesConfig) -> dict[str, Any]:
    """The list of a folder, as found or new.

    Raises:
        InvalidConfigError: when the folder holds states of another kind, seed or settings.
    """
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
