"""A tracked trajectory comes back as it was saved, or not at all."""

from pathlib import Path

import numpy as np
import pytest
import zarr

from clothtrack.errors import InvalidResultError, StorageError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.tracking import tracked_trajectory
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)


@pytest.fixture
def tracked() -> TrackedTrajectory:
    rng = np.random.default_rng(0)
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    mesh = ClothMesh(vertices, np.array([[0, 1, 2], [1, 3, 2]]), canonical=vertices)
    positions = rng.normal(size=(5, 4, 3)).astype(np.float32)
    calibration = Calibration(
        "grid", ("table_friction",), np.array([[0.5], [1.0]]), np.array([2e-4, 1e-4]), 1, 2.0
    )
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
    assert action.parameters == saved.parameters
    assert action.held_vertices == saved.held_vertices
    assert loaded.config == tracked.config
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fold.zarr"]


def test_a_full_disk_leaves_nothing_under_the_final_name(
    tracked: TrackedTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tracked_trajectory, "_write", full)
    with pytest.raises(StorageError, match="the disk is full"):
        tracked.save(tmp_path / "fold.zarr")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_leaves_nothing_half_written(
    tracked: TrackedTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = tracked_trajectory._put

    def interrupted(group: zarr.Group, name: str, *args: object, **kwargs: object) -> None:
        if name == "visible":
            raise KeyboardInterrupt
        written(group, name, *args, **kwargs)

    monkeypatch.setattr(tracked_trajectory, "_put", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tracked.save(tmp_path / "fold.zarr")
    assert list(tmp_path.iterdir()) == []


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
