"""The experiments with the network run on three small towels, and keep what they made."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra [learn] brings it")

from shared import learning_experiment, tables
from shared.bench_runs import read_rows, trajectories
from shared.learning_labels import (
    digest_of,
    kept_labels,
    label_mesh,
    simulated_labels,
    tracked_labels,
    true_labels,
    wrong_labels,
)
from shared.learning_measures import Case, canonical_errors, vertex_errors
from tables import network_alone

import clothtrack
from clothtrack.evaluation import Truth, material_map, material_points
from clothtrack.geometry import ClothMesh
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings import read_recording
from clothtrack_lab.published_networks.canonical_frame import conventional

ALWAYS = ("has_mesh", "canonical_median_mm", "cpu_s", "status")
OF_MESHES = (
    "error_all_mm", "error_symmetric_mm", "error_hidden_mm", "chamfer_pc_m2", "chamfer_floor_m2",
    "chamfer_label_m2", "chamfer_surface_m2", "edge_strain", "crossings",
)  # fmt: skip


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return tmp_path_factory.mktemp("bench")


@pytest.mark.slow
def test_an_experiment_runs_and_a_second_call_makes_nothing(bench, capsys):
    name, variants = "network_alone", 4
    assert network_alone.main(["--smoke", "--bench", str(bench)]) == 0
    first = capsys.readouterr()
    rows = [
        json.loads(line)
        for line in (bench / "experiments" / f"{name}.jsonl").read_text().splitlines()
    ]
    assert not [row["error"] for row in rows if "error" in row]
    assert len({row["variant"] for row in rows}) == variants
    for row in rows:
        assert row["experiment"] == name
        assert row["recording"] == "towel_0002"
        assert all(row[key] is not None for key in ALWAYS)
        assert all((row.get(key) is not None) == bool(row["has_mesh"]) for key in OF_MESHES)
        assert set(row["provenance"]) >= {"commit", "clothtrack", "packages", "weights"}
        assert "machine" not in row["provenance"]
        if row["has_mesh"]:
            assert row["error_symmetric_mm"] <= row["error_all_mm"] + 1e-9
    assert tables.markdown(name, rows) in first.out
    kept = {one: one.stat().st_mtime_ns for one in _kept(bench)}
    assert network_alone.main(["--smoke", "--bench", str(bench)]) == 0
    assert {one: one.stat().st_mtime_ns for one in _kept(bench)} == kept
    assert capsys.readouterr().out == first.out


@pytest.mark.slow
def test_the_token_network_serves_every_garment_and_is_told_it(bench, tmp_path):
    tokens = Path(clothtrack.__file__).parent / "reconstruction/weights/tokens.safetensors"
    words = ["--smoke", "--bench", str(bench), "--weights", str(tokens), "--out", str(tmp_path)]
    assert network_alone.main(words) == 0
    rows = read_rows(tmp_path / "network_alone.jsonl")
    assert {row["variant"] for row in rows} == {
        "network, template",
        "network, template, fine-tuned at test time",
    }
    (held_out,) = {row["recording"] for row in rows}
    told = read_recording(bench / "recordings" / held_out).cloth.template
    assert {row["vertices"] for row in rows} == {len(told.vertices)}


def _kept(bench):
    """Runs and rows of trajectories; not the experiment's own file."""
    out = bench / "experiments"
    return [one for name in ("runs", "reconstructions") for one in (out / name).rglob("*.*")]


@pytest.fixture(scope="module")
def runs(bench):
    """The default's runs of two towels."""
    options = learning_experiment.parse("x", ["--smoke", "--bench", str(bench)])
    setup = learning_experiment.prepared(options, bench)
    towels = sorted(trajectories(bench), key=lambda one: one.name)[:2]
    return setup.tracked(towels, setup.tracking.variant("default", "default"))


@pytest.mark.slow
def test_labels_are_the_trackers_the_truths_wrong_or_simulated(runs):
    tracked = [tracked_labels(task) for task in runs]
    true = [true_labels(task) for task in runs]
    wrong = [wrong_labels(task, 0.01) for task in runs]
    simulated = [simulated_labels(task) for task in runs]
    assert len({digest_of(each) for each in (tracked, true, wrong, simulated)}) == 4
    assert digest_of(tracked) == digest_of([tracked_labels(task) for task in runs])
    assert digest_of(wrong) == digest_of([wrong_labels(task, 0.01) for task in runs])
    assert digest_of(simulated) == digest_of([simulated_labels(task) for task in runs])
    for task, ours, known, moved, drawn in zip(runs, tracked, true, wrong, simulated, strict=True):
        last = read_recording(task.trajectory.recording).actions[0].last_frame
        for each in (ours, known, moved, drawn):
            assert each.frames == (0, last)
            assert len(each.pictures) == 2
        mesh, labels = kept_labels(task.file.with_suffix(".npz"))
        for each in (ours, drawn):
            np.testing.assert_allclose(each.pictures[1].positions, labels[0].vertices)
        np.testing.assert_allclose(label_mesh(task, labels[0].frame).vertices, labels[0].vertices)
        assert label_mesh(task, 1) is None
        truth = Truth.load(task.trajectory.truth)
        where = material_map(truth.canonical, truth.faces, np.asarray(mesh.canonical, float))
        wanted = material_points(truth.at(labels[0].frame), truth.faces, where)
        np.testing.assert_allclose(known.pictures[1].positions, wanted)
        # Wrong by as much as was asked for, along the table, alike in neighbors; flat it is right.
        np.testing.assert_array_equal(moved.pictures[0].positions, known.pictures[0].positions)
        gap = moved.pictures[1].positions - wanted
        assert np.linalg.norm(gap, axis=1).mean() == pytest.approx(0.01)
        assert not gap[:, 2].any()
        a, b = mesh.edges.T
        assert np.linalg.norm(gap[a] - gap[b], axis=1).mean() < 0.005
        # Another camera than the recording's has drawn what is simulated.
        assert drawn.pictures[1].camera != ours.pictures[1].camera


@pytest.mark.slow
def test_the_truth_has_no_error_and_its_look_alike_none_up_to_symmetry(runs):
    trajectory = runs[0].trajectory
    recording, truth = read_recording(trajectory.recording), Truth.load(trajectory.truth)
    frame = recording.actions[0].last_frame
    case = Case(recording, truth, frame, "towel")
    drawn, best = vertex_errors(ClothMesh(truth.at(frame), truth.faces, truth.canonical), case)
    assert drawn["all"].max < 1e-6
    assert drawn["visible"].count + drawn["hidden"].count == drawn["all"].count
    turned = ClothMesh(truth.at(frame), truth.faces, truth.canonical * (-1.0, -1.0, 1.0))
    drawn, best = vertex_errors(turned, case)
    assert drawn["all"].mean > 50.0
    assert best["all"].mean < 0.1
    # The same of canonical coordinates: right, and right but for the symmetry.
    surface = truth.at(frame)
    canonical = conventional(truth.canonical, "towel")
    top = surface[:, 2] > surface[:, 2].max() - 0.002
    seen = SeenPoints(surface[top], canonical[top] * (1.0, -1.0, -1.0), np.ones(top.sum()))
    errors = canonical_errors(seen, case)
    assert errors["canonical_median_mm"] < 1.0 < errors["canonical_drawn_mm"]
