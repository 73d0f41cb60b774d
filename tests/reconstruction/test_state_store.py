"""Shards of states: what was written is read, and nothing else is taken for it."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.state_store import (
    VERSION,
    StateShard,
    open_states,
    read_shard,
    write_shard,
    write_states,
)

HEAD = '{"format": "clothtrack-states", "version": 1, "kind": "towel"'


def make(kind: str = "towel", states: int = 4) -> StateShard:
    mesh = garment(kind, vertex_count=80)
    rng = np.random.default_rng(0)
    positions = rng.normal(0.0, 0.1, (states, mesh.vertex_count, 3)).astype(np.float32)
    return StateShard(
        kind=kind,
        mesh=mesh,
        positions=positions,
        episodes=np.arange(states, dtype=np.int32) // 2,
        recipes=("drop", "pick_and_place") * (states // 2),
        seed=7,
        measures={"speed": rng.random(states), "coverage": rng.random(states)},
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("written") / "0000.zarr"
    write_shard(make("tshirt"), target)
    return target


@pytest.fixture
def path(written: Path, tmp_path: Path) -> Path:
    """A copy of a shard, for a test to damage."""
    return Path(shutil.copytree(written, tmp_path / written.name))


def chunk_of(path: Path, array: str) -> Path:
    return max((path / array / "c").rglob("*"), key=lambda one: one.is_file())


def test_the_recipes_of_earlier_states_are_still_known(tmp_path: Path) -> None:
    earlier = (
        "flat", "fold", "drop", "lift", "held", "push", "pick_and_place", "release", "imported",
        "fold",
    )  # fmt: skip
    write_shard(replace(make(states=10), recipes=earlier), tmp_path / "0000.zarr")
    assert read_shard(tmp_path / "0000.zarr").recipes == earlier
    assert VERSION == 1


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"recipes": ("drop",)}, "recipes has 1"),
        ({"recipes": ("thrown",) * 4}, "thrown"),
        ({"positions": np.zeros((4, 3, 3), np.float32)}, "3 vertices"),
        ({"positions": np.full((4, 81, 3), np.nan, np.float32)}, "state 0"),
        ({"mesh": ClothMesh(make().mesh.vertices, make().mesh.faces)}, "canonical"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(changes: dict, told: str) -> None:
    with pytest.raises(InvalidResultError, match=told):
        replace(make(), **changes)


@pytest.mark.parametrize(
    ("document", "told"),
    [
        (None, r"states\.json"),
        ('{"format": "other", "version": 1, "kind": "towel"}', "other"),
        ("[1]", r"states\.json"),
        (HEAD + "}", "no shard"),
        (HEAD + ', "shards": {"0000.zarr": 3}}', r"states\.json: not the list of"),
        (HEAD + ', "shards": {"0000.zarr": {"states": "8"}}}', r"states\.json: not the list of"),
        (HEAD + ', "shards": [1]}', r"states\.json: not the list of"),
    ],
)
def test_a_folder_that_holds_no_states_is_told(
    tmp_path: Path, document: str | None, told: str
) -> None:
    if document:
        (tmp_path / "states.json").write_text(document)
    with pytest.raises(InvalidResultError, match=told):
        open_states(tmp_path)


def test_a_set_is_known_by_its_content_and_not_by_its_name(tmp_path: Path) -> None:
    first, second = (write_states(tmp_path / name, "towel", [make()], {}) for name in "ab")
    assert first.identity == second.identity
    moved = replace(make(), positions=make().positions + np.float32(1e-3))
    other = write_states(tmp_path / "c", "towel", [moved], {})
    assert other.identity != first.identity
    grown = write_states(tmp_path / "d", "towel", [make(), moved], {})
    assert (grown.identity["shards"], grown.identity["kind"]) == (2, "towel")
    assert grown.identity["sha256"] not in (first.identity["sha256"], other.identity["sha256"])


def test_what_is_written_is_read_and_written_again_to_the_bit(path: Path, tmp_path: Path) -> None:
    ours, theirs = make("tshirt"), read_shard(path)
    assert (theirs.kind, theirs.recipes, theirs.seed) == (ours.kind, ours.recipes, ours.seed)
    np.testing.assert_array_equal(ours.positions, theirs.positions)
    np.testing.assert_array_equal(ours.mesh.canonical, theirs.mesh.canonical)
    write_shard(theirs, tmp_path / "again.zarr")
    files = sorted(one.relative_to(path) for one in path.rglob("*") if one.is_file())
    assert len(files) > 10
    for name in files:
        assert (path / name).read_bytes() == (tmp_path / "again.zarr" / name).read_bytes(), name


def without_attributes(path: Path) -> None:
    document = json.loads((path / "zarr.json").read_text())
    document["attributes"] = {}
    (path / "zarr.json").write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda path: chunk_of(path, "positions").unlink(), "positions"),
        (lambda path: chunk_of(path, "measures/speed").unlink(), "measures/speed"),
        (lambda path: chunk_of(path, "faces").write_bytes(b"half"), "faces"),
        (lambda path: shutil.rmtree(path / "canonical"), "canonical"),
        (lambda path: (path / "zarr.json").write_text("{"), r"0000\.zarr"),
        (without_attributes, "not finished"),
        (shutil.rmtree, "--states"),
    ],
)
def test_a_damaged_shard_is_told(path: Path, damage: Callable[[Path], object], told: str) -> None:
    damage(path)
    with pytest.raises(InvalidResultError, match=told) as error:
        read_shard(path)
    assert str(path) in str(error.value)
