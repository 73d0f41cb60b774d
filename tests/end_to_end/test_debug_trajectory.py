"""The whole way of a recording: simulate, inspect, track, evaluate, export, view."""

import json
from pathlib import Path

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

NAME = "towel_0001"


@pytest.fixture(scope="module")
def results(towels, tmp_path_factory) -> Path:
    """Folder with `default/NAME.zarr` and `open_loop/NAME.zarr`."""
    out = tmp_path_factory.mktemp("results")
    recording = str(towels / "recordings" / NAME)
    for mode in ("default", "open_loop"):
        words = ["track", recording, "--output", str(out / mode), "--mode", mode]
        assert cli.main([*words, "--set", "search.method=none"]) == 0
    return out


def test_a_filmed_recording_is_valid(towels, capsys):
    for name in (NAME, "towel_0002"):
        assert cli.main(["inspect", str(towels / "recordings" / name), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["valid"] is True


def test_tracking_beats_the_dynamics_alone(towels, results, capsys):
    """The tip is measured wrongly, so only what the camera saw can put the cloth right."""
    errors = {}
    words = ["--recordings", str(towels / "recordings"), "--truth", str(towels / "truth"), "--json"]
    for mode in ("default", "open_loop"):
        capsys.readouterr()
        assert cli.main(["evaluate", str(results / mode / f"{NAME}.zarr"), *words]) == 0
        (found,) = json.loads(capsys.readouterr().out)
        (last,) = [row for row in found["rows"] if row["stage"] == "after_final_alignment"]
        errors[mode] = last["vertex_error_mm"]["all"]["mean"]
    assert errors["default"] < 0.75 * errors["open_loop"]


def test_tracking_is_a_function_of_its_input(towels, results, tmp_path):
    folder = towels / "recordings" / NAME
    words = ["track", str(folder), "--output", str(tmp_path)]
    assert cli.main([*words, "--set", "search.method=none"]) == 0
    again = TrackedTrajectory.load(tmp_path / f"{NAME}.zarr")
    before = TrackedTrajectory.load(results / "default" / f"{NAME}.zarr")
    np.testing.assert_array_equal(again.positions, before.positions)


def test_every_frame_has_a_mesh_and_no_more(towels, results):
    tracked = TrackedTrajectory.load(results / "default" / f"{NAME}.zarr")
    assert len(tracked.positions) == len(read_recording(towels / "recordings" / NAME).frames)
    assert np.isfinite(tracked.positions).all()
    assert tracked.provenance["config_hash"]
    kept = [tracked.steps.predict_s, tracked.steps.align_s, tracked.steps.correct_s]
    assert tracked.provenance["cpu_s"] > np.nansum(kept) > 0.0
    assert tracked.provenance["recording"]["seed"] == 1


def test_meshes_are_exported(results, tmp_path):
    path = results / "default" / f"{NAME}.zarr"
    tracked = TrackedTrajectory.load(path)
    npz = tmp_path / "all.npz"
    assert cli.main(["export", str(path), "--output", str(npz), "--format", "npz"]) == 0
    with np.load(npz) as arrays:
        np.testing.assert_array_equal(arrays["positions"], tracked.positions)
    assert cli.main(["export", str(path), "--output", str(tmp_path / "obj")]) == 0
    assert len(list((tmp_path / "obj").glob("frame_*.obj"))) == len(tracked.frames)


@pytest.mark.slow
def test_the_demo_tracks_what_is_shipped(tmp_path, capsys):
    name = shipped_recording().name
    assert cli.main(["demo", "--output", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert str(tmp_path / f"{name}.html") in told
    tracked = TrackedTrajectory.load(tmp_path / f"{name}.zarr")
    assert all(action.calibration.roll_outs > 0 for action in tracked.actions)
