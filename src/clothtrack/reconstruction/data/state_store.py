"""Labeled states of a garment on disk: one Zarr group per garment, and the folder of them.

    OUT/states.json            settings, seed, versions, and the list of finished shards
    OUT/shards/0000.zarr       all states of one garment
    OUT/README.md              the dataset card

A shard is written under a temporary name and renamed, so a shard under its final name is complete.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from jaxtyping import Float, Float32, Int

from clothtrack.errors import InvalidMeshError, InvalidResultError
from clothtrack.files.arrays import DAMAGE, put_array, take_array
from clothtrack.files.atomic_write import atomic_file, atomic_folder
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.identity import array_digest

FORMAT = "clothtrack-states"
VERSION = 1
LIST_FILE = "states.json"
SHARD_FOLDER = "shards"

_RECIPES = (
    "flat", "fold", "fold_half", "fold_corner", "fold_top", "fold_strips", "fold_sleeves", "roll",
    "turn_over", "drop", "lift", "held", "push", "pick_and_place", "release", "imported",
)  # fmt: skip
"""Names of recipes of states; the last one is for states of other data sets."""

MEASURES: Mapping[str, str] = {
    "speed": "m/s",
    "strain": "1",
    "coverage": "1",
    "crossings": "1",
}
"""Measures that may be stored per state, and their units (`StateShard.measures`)."""


_CONTENT = ("positions", "rest_positions", "canonical", "faces")
"""Arrays by whose values a shard is known."""


@dataclass(frozen=True, eq=False)
class StateShard:
    """States of one garment.

    Attributes:
        kind: kind of garment, such as "towel" or "tshirt".
        mesh: flat rest shape with its canonical coordinates [m].
        positions: vertices of each state [m]; world frame, z up, the table at z = 0.
        episodes: episode of each state; a split into training and validation must not separate
            states of one episode.
        recipes: recipe of each state, one of `_RECIPES`.
        measures: values per state by name: "speed", final speed of its fastest vertex [m/s];
            "strain", mean absolute relative change of edge length; "coverage", projected area over
            that of the flat garment; "crossings", number of edges that pass through a triangle.
    """

    kind: str
    mesh: ClothMesh
    positions: Float32[np.ndarray, "states vertices 3"]
    episodes: Int[np.ndarray, " states"]
    recipes: tuple[str, ...]
    seed: int
    measures: Mapping[str, Float[np.ndarray, " states"]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Reject inconsistent parts."""
        states, vertices = self.positions.shape[:2]
        found = {
            "episodes": len(self.episodes),
            "recipes": len(self.recipes),
            **{f"measures.{name}": len(values) for name, values in self.measures.items()},
        }
        for name, count in found.items():
            if count != states:
                raise InvalidResultError(
                    f"{name} has {count} entries for {states} states; it needs one per state"
                )
        if vertices != self.mesh.vertex_count:
            raise InvalidResultError(
                f"positions have {vertices} vertices, the mesh has {self.mesh.vertex_count}"
            )
        if self.mesh.canonical is None:
            raise InvalidResultError(
                "the mesh has no canonical coordinates, which are what a state is labeled with"
            )
        for state, finite in enumerate(np.isfinite(self.positions).all(axis=(1, 2))):
            if not finite:
                raise InvalidResultError(
                    f"positions of state {state} are not all finite; leave that state out"
                )
        if unknown := set(self.recipes) - set(_RECIPES):
            raise InvalidResultError(
                f"recipe {min(unknown)!r} is not known; it must be one of {', '.join(_RECIPES)}"
            )


@dataclass(frozen=True, eq=False)
class StateSet:
    """A folder of shards.

    Attributes:
        kind: kind of garment of all its shards.
    """

    folder: Path
    kind: str
    shards: tuple[Path, ...]
    document: Mapping[str, Any]

    @property
    def identity(self) -> dict[str, Any]:
        """Identity of the set, independent of its path: kind, shards and SHA-256 of the content."""
        digests = "".join(map(shard_digest, self.shards))
        sha256 = hashlib.sha256(digests.encode()).hexdigest()
        return {"kind": self.kind, "shards": len(self.shards), "sha256": sha256}


def write_shard(shard: StateShard, path: Path) -> None:
    """Write a shard as a Zarr group atomically; an existing one is replaced."""
    with atomic_folder(path, replace=True) as temporary:
        _write(zarr.open_group(temporary, mode="w", zarr_format=3), shard)


def read_shard(path: Path) -> StateShard:
    """Read a shard that `write_shard` has written."""
    path = Path(path)
    if not (path / "zarr.json").is_file():
        raise InvalidResultError(
            f"{path} is not a shard of states (no zarr.json); make states with: "
            "clothtrack simulate OUT --states N"
        )
    try:
        group = zarr.open_group(path, mode="r")
        _check_version(group)
        return _read(group)
    except InvalidResultError as error:
        raise InvalidResultError(f"{path}: {error}") from error
    except (InvalidMeshError, *DAMAGE) as error:
        raise InvalidResultError(
            f"{path}: not a whole shard of states ({error}); remove it and run the command that "
            "made it again"
        ) from error


def shard_digest(path: Path) -> str:
    """Return the stored SHA-256 of a shard's states and mesh; the arrays are not read."""
    try:
        group = zarr.open_group(path, mode="r")
        parts = [str(group[name].attrs["sha256"]) for name in _CONTENT]
    except DAMAGE as error:
        raise InvalidResultError(
            f"{path}: not a whole shard of states ({error}); remove it and run the command that "
            "made it again"
        ) from error
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def open_states(folder: Path) -> StateSet:
    """Open a folder of states; the shards themselves are not read."""
    folder = Path(folder)
    document = read_list(folder)
    if document is None:
        raise InvalidResultError(
            f"{folder}: no {LIST_FILE} in it; make states with: clothtrack simulate OUT --states N"
        )
    shards = tuple(sorted((folder / SHARD_FOLDER).glob("[0-9]*.zarr")))
    if not shards:
        raise InvalidResultError(
            f"{folder / SHARD_FOLDER}: no shard is finished; run the command that began it again"
        )
    return StateSet(folder, document["kind"], shards, document)


def read_list(folder: Path) -> dict[str, Any] | None:
    """Return the content of `states.json`; None if there is none."""
    path = Path(folder) / LIST_FILE
    if not path.exists():
        return None
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        found = document["format"], document["version"], document["kind"]
        if found[:2] != (FORMAT, VERSION) or not isinstance(found[2], str):
            raise ValueError(f"it is {found[0]!r:.80}, version {found[1]!r:.80}")
        for name, shard in document.get("shards", {}).items():
            known = isinstance(shard["cpu_s"], int | float | type(None))
            if not (known and isinstance(shard["states"], int)):
                raise ValueError(f"shard {name} without its states and its time")
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InvalidResultError(
            f"{path}: not the list of {FORMAT} version {VERSION} ({error}); choose another folder "
            "or make it again"
        ) from error
    return document


def write_list(folder: Path, document: Mapping[str, Any]) -> None:
    """Write `states.json` atomically; format and version are added."""
    text = json.dumps({"format": FORMAT, "version": VERSION, **document}, indent=1)
    with atomic_file(Path(folder) / LIST_FILE) as unfinished:
        unfinished.write_text(text + "\n", encoding="utf-8")


def write_states(
    folder: Path, kind: str, shards: Sequence[StateShard], provenance: Mapping[str, Any]
) -> StateSet:
    """Write imported shards as a folder of states."""
    folder = Path(folder)
    if (folder / LIST_FILE).exists():
        raise InvalidResultError(f"{folder} holds states already; choose another folder")
    for number, shard in enumerate(shards):
        if shard.kind != kind:
            raise InvalidResultError(f"shard {number} is a {shard.kind!r}, not a {kind!r}")
        write_shard(shard, shard_path(folder, number))
    write_list(folder, {"kind": kind, "provenance": dict(provenance)})
    return open_states(folder)


def shard_path(folder: Path, number: int) -> Path:
    """Return the path of shard `number` of a folder."""
    return Path(folder) / SHARD_FOLDER / f"{number:04d}.zarr"


def _write(group: zarr.Group, shard: StateShard) -> None:
    for name, values in (
        ("positions", shard.positions),
        ("rest_positions", shard.mesh.vertices),
        ("canonical", np.asarray(shard.mesh.canonical)),
        ("faces", shard.mesh.faces),
    ):
        put_array(group, name, values, unit="" if name == "faces" else "m")
        group[name].attrs["sha256"] = array_digest(values)
    put_array(group, "episodes", shard.episodes)
    for name, values in shard.measures.items():
        put_array(group, f"measures/{name}", values, unit=MEASURES.get(name, ""))
    group.attrs.update(
        {
            "format": FORMAT,
            "version": VERSION,
            "kind": shard.kind,
            "recipes": list(shard.recipes),
            "seed": shard.seed,
            "measures": list(shard.measures),
        }
    )


def _take(group: zarr.Group, name: str) -> np.ndarray:
    try:
        return take_array(group, name)
    except InvalidResultError as error:
        raise InvalidResultError(
            f"{error}; remove the shard and run the command that made it again"
        ) from error


def _check_version(group: zarr.Group) -> None:
    found = group.attrs.get("format"), group.attrs.get("version")
    if found != (FORMAT, VERSION):
        raise InvalidResultError(
            f"its format is {found[0]!r:.80} version {found[1]!r:.80}, this clothtrack reads "
            f"{FORMAT!r} version {VERSION}; it was not finished or is something else"
        )


def _read(group: zarr.Group) -> StateShard:
    positions = _take(group, "positions")
    if positions.dtype != np.float32 or positions.ndim != 3 or positions.shape[2] != 3:
        raise InvalidResultError(
            f"array positions is {positions.dtype} {positions.shape}; it must be float32 "
            "(states, vertices, 3)"
        )
    measures = cast("list[str]", group.attrs["measures"])
    return StateShard(
        kind=str(group.attrs["kind"]),
        mesh=ClothMesh(
            _take(group, "rest_positions"), _take(group, "faces"), _take(group, "canonical")
        ),
        positions=positions,
        episodes=_take(group, "episodes"),
        recipes=tuple(map(str, group.attrs["recipes"])),
        seed=int(group.attrs["seed"]),
        measures={name: _take(group, f"measures/{name}") for name in measures},
    )
