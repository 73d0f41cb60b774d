"""Shards of states: what was written is read, and nothing else is taken for it."""

import json
import shutil
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
    read_list,
    read_shard,
    shard_digest,
    shard_path,
    write_shard,
    write_states,
)


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


def test_what_is_written_is_read(path: Path) -> None:
    ours, theirs = make("tshirt"), read_shard(path)
    assert (theirs.kind, theirs.recipes, theirs.seed) == (ours.kind, ours.recipes, ours.seed)
    for one, other in (
        (ours.positions, theirs.positions),
        (ours.episodes, theirs.episodes),
        (ours.mesh.vertices, theirs.mesh.vertices),
        (ours.mesh.faces, theirs.mesh.faces),
        (ours.mesh.canonical, theirs.mesh.canonical),
        (ours.measures["speed"], theirs.measures["speed"]),
    ):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


def test_equal_shards_have_equal_bytes(path: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.zarr"
    write_shard(make("tshirt"), again)
    files = sorted(one.relative_to(path) for one in path.rglob("*") if one.is_file())
    assert len(files) > 10
    for name in files:
        assert (path / name).read_bytes() == (again / name).read_bytes(), name


def test_a_shard_is_replaced_whole_and_nothing_else_is_left(path: Path) -> None:
    write_shard(make("towel"), path)
    assert read_shard(path).kind == "towel"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("array", ["positions", "faces", "measures/speed"])
def test_a_chunk_that_is_gone_is_told(path: Path, array: str) -> None:
    chunk_of(path, array).unlink()
    with pytest.raises(InvalidResultError, match=array) as told:
        read_shard(path)
    assert str(path) in str(told.value)


def test_a_truncated_chunk_is_told(path: Path) -> None:
    chunk = chunk_of(path, "positions")
    chunk.write_bytes(chunk.read_bytes()[: chunk.stat().st_size // 2])
    with pytest.raises(InvalidResultError, match="positions"):
        read_shard(path)


def test_an_array_that_is_gone_is_told(path: Path) -> None:
    shutil.rmtree(path / "canonical")
    with pytest.raises(InvalidResultError, match="canonical"):
        read_shard(path)


def test_an_unfinished_shard_is_told(path: Path) -> None:
    document = json.loads((path / "zarr.json").read_text())
    document["attributes"] = {}
    (path / "zarr.json").write_text(json.dumps(document))
    with pytest.raises(InvalidResultError, match="not finished"):
        read_shard(path)
    (path / "zarr.json").write_text("{")
    with pytest.raises(InvalidResultError, match=r"0000\.zarr"):
        read_shard(path)


def test_altered_attributes_are_told_and_shards_from_before_are_read(path: Path) -> None:
    file = path / "zarr.json"
    whole = file.read_text()
    assert "pick_and_place" in whole
    for old, new in (('"drop"', '"lift"'), ('"seed": 7', '"seed": 8'), ('"sha256"', '"sha25v"')):
        assert old in whole
        file.write_text(whole.replace(old, new))
        with pytest.raises(InvalidResultError, match=r"0000\.zarr.*attributes"):
            read_shard(path)
    document = json.loads(whole)
    for name in ("sha256", "contents"):
        del document["attributes"][name]
    file.write_text(json.dumps(document))
    assert read_shard(path).seed == 7


def test_no_shard_is_told(tmp_path: Path) -> None:
    with pytest.raises(InvalidResultError, match="--states"):
        read_shard(tmp_path / "none.zarr")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"recipes": ("drop",)}, "recipes has 1"),
        ({"recipes": ("thrown",) * 4}, "thrown"),
        ({"positions": np.zeros((4, 3, 3), np.float32)}, "3 vertices"),
        ({"positions": np.full((4, 81, 3), np.nan, np.float32)}, "state 0"),
    ],
)
def test_parts_that_do_not_belong_together_are_refused(changes: dict, told: str) -> None:
    shard = make()
    assert shard.mesh.vertex_count == 81
    with pytest.raises(InvalidResultError, match=told):
        replace(shard, **changes)


def test_a_mesh_without_labels_is_refused() -> None:
    shard = make()
    bare = ClothMesh(shard.mesh.vertices, shard.mesh.faces)
    with pytest.raises(InvalidResultError, match="canonical"):
        replace(shard, mesh=bare)


def test_a_folder_of_states_is_opened_in_order(tmp_path: Path) -> None:
    made = write_states(tmp_path / "set", "towel", [make(), make()], {"source": "a test"})
    found = open_states(tmp_path / "set")
    assert found.kind == "towel"
    assert found.shards == made.shards == tuple(shard_path(found.folder, k) for k in range(2))
    assert found.document["provenance"] == {"source": "a test"}
    (found.folder / "shards" / ".0002.zarr.abc").mkdir()
    assert open_states(found.folder).shards == found.shards


def test_states_are_not_written_over_others(tmp_path: Path) -> None:
    write_states(tmp_path, "towel", [make()], {})
    with pytest.raises(InvalidResultError, match="another folder"):
        write_states(tmp_path, "towel", [make()], {})
    with pytest.raises(InvalidResultError, match="tshirt"):
        write_states(tmp_path / "new", "towel", [make("tshirt")], {})


def test_a_folder_that_holds_no_states_is_told(tmp_path: Path) -> None:
    with pytest.raises(InvalidResultError, match=r"states\.json"):
        open_states(tmp_path)
    (tmp_path / "states.json").write_text('{"format": "other", "version": 1, "kind": "towel"}')
    with pytest.raises(InvalidResultError, match="other"):
        open_states(tmp_path)
    (tmp_path / "states.json").write_text("[1]")
    with pytest.raises(InvalidResultError, match=r"states\.json"):
        open_states(tmp_path)
    (tmp_path / "states.json").write_text(
        '{"format": "clothtrack-states", "version": 1, "kind": "towel"}'
    )
    with pytest.raises(InvalidResultError, match="no shard"):
        open_states(tmp_path)


@pytest.mark.parametrize(
    "shards", ['{"0000.zarr": 3}', '{"0000.zarr": {"states": "8", "cpu_s": 1}}', "[1]", "7"]
)
def test_a_list_of_states_with_wrong_shards_is_told(tmp_path: Path, shards: str) -> None:
    head = '{"format": "clothtrack-states", "version": 1, "kind": "towel", "shards": '
    (tmp_path / "states.json").write_text(head + shards + "}")
    with pytest.raises(InvalidResultError, match=r"states\.json: not the list of"):
        read_list(tmp_path)


def test_a_set_is_known_by_its_content_and_not_by_its_name(tmp_path: Path) -> None:
    first, second = (write_states(tmp_path / name, "towel", [make()], {}) for name in "ab")
    assert first.identity == second.identity
    moved = replace(make(), positions=make().positions + np.float32(1e-3))
    other = write_states(tmp_path / "c", "towel", [moved], {})
    assert other.identity != first.identity
    grown = write_states(tmp_path / "d", "towel", [make(), moved], {})
    assert (grown.identity["shards"], grown.identity["kind"]) == (2, "towel")
    assert grown.identity["sha256"] not in (first.identity["sha256"], other.identity["sha256"])


def test_a_shard_without_an_array_has_no_digest(tmp_path: Path) -> None:
    (path,) = write_states(tmp_path / "a", "towel", [make()], {}).shards
    shutil.rmtree(path / "faces")
    with pytest.raises(InvalidResultError, match=r"0000\.zarr: not a whole shard of states"):
        shard_digest(path)
