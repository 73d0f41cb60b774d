"""A tracked trajectory comes back as it was saved, or not at all."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zarr

from clothtrack.errors import InvalidResultError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)


@pytest.fixture(scope="module")
def tracked() -> TrackedTrajectory:
    rng = np.random.default_rng(0)
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    mesh = ClothMesh(vertices, np.array([[0, 1, 2], [1, 3, 2]]), canonical=vertices)
    positions = rng.normal(size=(5, 4, 3)).astype(np.float32)
    calibration = Calibration(
        "grid", ("table_friction",), np.array([[0.5], [1.0]]), np.array([2e-4, 1e-4]), 1, 2.0,
        spread_m=np.array([0.0, 1e-3, 2e-3, 0.5]),
    )  # fmt: skip
    action = TrackedAction(
        0, 4, positions[3], positions[4], np.array([2e-4, 1e-4]), {"table_friction": 1.0},
        calibration, {"tweezer": (3,)},
    )  # fmt: skip
    return TrackedTrajectory(
        name="fold",
        mesh=mesh,
        frames=np.arange(5),
        time_s=np.arange(5) / 20,
        positions=positions,
        visible=rng.random((5, 4)) > 0.5,
        actions=(action,),
        steps=StepRecords.empty(5),
        config={"seed": 0},
        provenance={"device": "cpu"},
    )


def test_round_trip_keeps_every_bit(tracked: TrackedTrajectory, tmp_path: Path) -> None:
    tracked.save(tmp_path / "fold.zarr")
    loaded = TrackedTrajectory.load(tmp_path / "fold.zarr")
    for name in ("frames", "time_s", "positions", "visible"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(tracked, name))
    np.testing.assert_array_equal(loaded.mesh.canonical, tracked.mesh.canonical)
    np.testing.assert_array_equal(loaded.mesh.edges, tracked.mesh.edges)
    (action,), (saved,) = loaded.actions, tracked.actions
    np.testing.assert_array_equal(
        action.positions_before_final_alignment, saved.positions_before_final_alignment
    )
    np.testing.assert_array_equal(action.calibration.scores, saved.calibration.scores)
    np.testing.assert_allclose(action.calibration.spread_m, saved.calibration.spread_m, rtol=1e-7)
    assert action.parameters == saved.parameters
    assert action.held_vertices == saved.held_vertices
    assert loaded.config == tracked.config
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fold.zarr"]


def test_unfinished_foreign_and_future_groups_are_refused(
    tracked: TrackedTrajectory, tmp_path: Path
) -> None:
    with pytest.raises(InvalidResultError, match="clothtrack track"):
        TrackedTrajectory.load(tmp_path / "none.zarr")
    zarr.open_group(tmp_path / "empty.zarr", mode="w")
    with pytest.raises(InvalidResultError, match="not finished"):
        TrackedTrajectory.load(tmp_path / "empty.zarr")
    tracked.save(tmp_path / "fold.zarr")
    zarr.open_group(tmp_path / "fold.zarr", mode="r+").attrs["version"] = 99
    with pytest.raises(InvalidResultError, match="version 99"):
        TrackedTrajectory.load(tmp_path / "fold.zarr")
    zarr.open_group(tmp_path / "fold.zarr", mode="r+").attrs["format"] = {"long": ["x"] * 1000}
    with pytest.raises(InvalidResultError, match="its format is") as told:
        TrackedTrajectory.load(tmp_path / "fold.zarr")
    assert len(str(told.value)) < 500


@pytest.fixture(scope="module")
def saved(tracked: TrackedTrajectory, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("saved") / "fold.zarr"
    tracked.save(target)
    return target


@pytest.fixture
def path(saved: Path, tmp_path: Path) -> Path:
    """A copy of a saved result, for a test to damage."""
    return Path(shutil.copytree(saved, tmp_path / saved.name))


def attributes_of(path: Path, change: Callable[[dict], object]) -> None:
    """Change the attributes of a group on disk."""
    document = json.loads((path / "zarr.json").read_text())
    change(document["attributes"])
    (path / "zarr.json").write_text(json.dumps(document))


def refused(path: Path) -> str:
    """The one line with which a damaged result is refused."""
    with pytest.raises(InvalidResultError) as told:
        TrackedTrajectory.load(path)
    line = str(told.value)
    assert line.startswith(f"{path}")
    assert "track the recording again" in line
    assert "\n" not in line
    return line


@pytest.mark.parametrize(
    "change",
    [
        lambda found: found.pop("name"),
        lambda found: found.update(action_count="one"),
        lambda found: found.update(version=1),
    ],
)
def test_attributes_that_cannot_be_are_told(path: Path, change: Callable) -> None:
    attributes_of(path, change)
    refused(path)


@pytest.mark.parametrize("named", ["config", "provenance"])
def test_what_is_no_set_of_named_values_is_told(path: Path, named: str) -> None:
    attributes_of(path, lambda found: found.update({named: ["adam", 3]}))
    assert f"its {named} is ['adam', 3]" in refused(path)


def test_values_that_cannot_be_are_told(tracked: TrackedTrajectory, tmp_path: Path) -> None:
    positions = tracked.positions.copy()
    positions[2, 1, 0] = np.nan
    wrong = {"array positions is not finite": {"positions": positions}}
    for first, last in ((-1, 4), (0, 5), (3, 2)):
        action = replace(tracked.actions[0], first_frame=first, last_frame=last)
        wrong[f"frames {first} to {last}"] = {"actions": (action,)}
    for number, (told, changes) in enumerate(wrong.items()):
        replace(tracked, **changes).save(tmp_path / f"{number}.zarr")
        assert told in refused(tmp_path / f"{number}.zarr")


def test_a_result_of_before_has_no_spread(tracked: TrackedTrajectory, tmp_path: Path) -> None:
    (action,) = tracked.actions
    for count in (0, 3):
        calibration = replace(action.calibration, spread_m=np.zeros(count))
        written = replace(tracked, actions=(replace(action, calibration=calibration),))
        written.save(tmp_path / f"{count}.zarr")
    (read,) = TrackedTrajectory.load(tmp_path / "0.zarr").actions
    assert read.calibration.spread_m.shape == (0,)
    assert "calibration_spread has shape" in refused(tmp_path / "3.zarr")


@pytest.mark.parametrize(
    ("gone", "named"),
    [
        ("positions/c/3/0/0", "array positions"),
        ("actions/0/positions_after_final_alignment/c", "array actions/0/positions_after"),
        ("steps", "steps"),
        ("actions/0/zarr.json", "actions/0"),
        ("time_s/zarr.json", "time_s"),
    ],
)
def test_what_is_gone_is_named(path: Path, gone: str, named: str) -> None:
    """Zarr reads a chunk that is missing as zeros."""
    target = path / gone
    shutil.rmtree(target) if target.is_dir() else target.unlink()
    assert named in refused(path)


def test_a_damaged_chunk_is_named(path: Path) -> None:
    chunk = path / "positions" / "c" / "3" / "0" / "0"
    whole = chunk.read_bytes()
    for damaged in (b"no compressed values", whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:]):
        chunk.write_bytes(damaged)
        assert "array positions cannot be read" in refused(path)


def test_a_run_from_before_zarr_checked_its_chunks_is_read(
    tracked: TrackedTrajectory, tmp_path: Path
) -> None:
    shutil.unpack_archive(Path(__file__).with_name("run_with_digests.zip"), tmp_path / "old.zarr")
    before = TrackedTrajectory.load(tmp_path / "old.zarr")
    for name in ("frames", "time_s", "positions", "visible"):
        np.testing.assert_array_equal(getattr(before, name), getattr(tracked, name))
    assert (before.config, before.provenance) == (tracked.config, tracked.provenance)
    assert before.actions[0].parameters == {"table_friction": 1.0}


@pytest.mark.parametrize("name", ["../../../x", "/tmp/x", "..", "", "a\\b", "a\nb", "x" * 201])
def test_a_name_that_leads_out_of_a_folder_is_refused(
    tracked: TrackedTrajectory, tmp_path: Path, name: str
) -> None:
    replace(tracked, name=name).save(tmp_path / "fold.zarr")
    assert "its name is" in refused(tmp_path / "fold.zarr")
