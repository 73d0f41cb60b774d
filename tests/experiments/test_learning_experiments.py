"""The experiments with the network run on three small towels, and keep what they made."""

import importlib
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra [learn] brings it")

from figures import real_reconstruction, reconstruction_figure, states_sheet
from shared import learning_columns, learning_experiment, tables
from shared.bench_runs import read_rows, trajectories
from shared.learning_labels import (
    digest_of,
    kept_labels,
    label_mesh,
    old_labels,
    tracked_labels,
    true_labels,
)
from shared.learning_measures import Case, canonical_errors, vertex_errors
from tables import network_alone

import clothtrack
from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation import Truth, material_map, material_points
from clothtrack.geometry import ClothMesh
from clothtrack.reconstruction.data.recipes import CrumplingConfig
from clothtrack.reconstruction.data.states import StatesConfig, generate_states
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings import read_recording
from clothtrack_lab.published_networks.canonical_frame import conventional

VARIANTS = {"table2": 7, "label_count": 3, "network_alone": 4}
ALWAYS = ("has_mesh", "canonical_median_mm", "cpu_s", "status")
OF_MESHES = (
    "error_all_mm", "error_symmetric_mm", "error_hidden_mm", "chamfer_pc_m2", "chamfer_floor_m2",
    "chamfer_label_m2", "chamfer_surface_m2", "edge_strain", "crossings",
)  # fmt: skip


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return tmp_path_factory.mktemp("bench")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "variants"), VARIANTS.items())
def test_an_experiment_runs_and_a_second_call_makes_nothing(name, variants, bench, capsys):
    module = importlib.import_module(f"tables.{name}")
    assert module.main(["--smoke", "--bench", str(bench)]) == 0
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
    assert module.main(["--smoke", "--bench", str(bench)]) == 0
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
    """Runs, fine-tuned networks and rows of trajectories; not the experiment's own file."""
    out = bench / "experiments"
    return [
        one for name in ("runs", "networks", "reconstructions") for one in (out / name).rglob("*.*")
    ]


@pytest.mark.slow
def test_ten_states_are_drawn(bench, tmp_path, capsys):
    image = tmp_path / "states.png"
    arguments = ["--smoke", "--bench", str(bench), "--image", str(image)]
    assert reconstruction_figure.main(arguments) == 0
    picture = cv2.imread(str(image))
    # One held-out towel of one action: one line of six pictures under its words.
    width = 6 * reconstruction_figure.WIDTH + 5 * 3
    assert picture.shape == (reconstruction_figure.HEIGHT + 22, width, 3)
    assert np.ptp(picture[22:, -reconstruction_figure.WIDTH :], axis=(0, 1)).max() > 60
    assert "1 states" in capsys.readouterr().out


def test_a_sheet_of_states_is_drawn(tmp_path, capsys):
    config = StatesConfig(
        vertex_count=120, episodes=2, crumpling=CrumplingConfig(states=2, rest_limit_s=0.2)
    )
    generate_states(tmp_path / "towels", "towel", 4, config=config)
    image = tmp_path / "sheet.png"
    words = ["--states", str(tmp_path / "towels"), "--count", "4", "--columns", "3"]
    assert states_sheet.main([*words, "--image", str(image)]) == 0
    tile = states_sheet.TILE
    assert cv2.imread(str(image)).shape == (2 * (tile + states_sheet.LETTERS), 3 * tile, 3)
    assert "kB" in capsys.readouterr().out
    assert states_sheet.main(["--states", str(tmp_path), "--image", str(image)]) == 1


@pytest.mark.slow
def test_states_come_evenly_from_all(bench):
    simulated = trajectories(bench)
    towels = [one for one in simulated if one.name in ("towel_0000", "towel_0001", "towel_0002")]
    names = [each.trajectory.name for each in reconstruction_figure.states(towels, 2)]
    assert names == ["towel_0000", "towel_0002"]


@pytest.mark.slow
def test_real_recordings_are_drawn_and_absent_ones_say_why(tmp_path, capsys):
    images = tmp_path / "images"
    assert real_reconstruction.main(["--smoke", "--images", str(images)]) == 0
    report = json.loads((images / "real_reconstruction.json").read_text())
    assert report["towel_0000"]["image"] == "towel_0000.png"
    assert (images / "towel_0000.png").stat().st_size > 5_000
    figures = report["towel_0000"]["cloud_to_vertices_m2"]
    assert figures["fine-tuned at test time"] <= figures["network"]
    skipped = {name for name, one in report.items() if "skipped" in one}
    assert skipped == {one.name for one in real_reconstruction.SETS}
    assert "skipped, there is no" in capsys.readouterr().out


def test_splits_that_overlap_are_refused(bench, capsys):
    module = importlib.import_module("tables.network_alone")
    weights = learning_experiment.tiny_network(bench / "tiny.safetensors")
    words = ["--bench", str(bench), "--weights", str(weights), "--split", "dev"]
    assert module.main(words) == 1
    assert "must not be learned from" in capsys.readouterr().err


@pytest.mark.slow
def test_a_recording_to_learn_from_is_found_again_under_another_name(bench, tmp_path, capsys):
    """Two towels without a list, and a copy of the first that comes last, to be measured on."""
    importlib.import_module("tables.network_alone").main(["--smoke", "--bench", str(bench)])
    weights = learning_experiment.tiny_network(tmp_path / "tiny.safetensors")
    for name, source in (("towel_0000", 0), ("towel_0001", 1), ("towel_0009", 0)):
        for part in ("recordings", "truth"):
            (tmp_path / part).mkdir(exist_ok=True)
            suffix = ".npz" if part == "truth" else ""
            old = bench / part / f"towel_000{source}{suffix}"
            (tmp_path / part / f"{name}{suffix}").symlink_to(old)
    words = ["--bench", str(tmp_path), "--weights", str(weights)]
    for experiment in ("table2", "label_count"):
        module = importlib.import_module(f"tables.{experiment}")
        capsys.readouterr()
        assert module.main(words) == 1
        (line,) = capsys.readouterr().err.splitlines()[-1:]
        assert "towel_0000, to learn from, and " in line
        assert "towel_0009, to measure on" in line
        assert not (tmp_path / "experiments" / "networks").exists()


@pytest.fixture(scope="module")
def runs(bench):
    """The default's runs of the towels that are learned from."""
    options = learning_experiment.parse("x", ["--smoke", "--bench", str(bench)])
    setup = learning_experiment.prepared(options, bench)
    tasks = setup.tracked(setup.training("towel"), setup.tracking.variant("default", "default"))
    return setup, tasks


@pytest.mark.slow
def test_labels_are_the_trackers_the_truths_or_the_old_cloths(runs):
    setup, tasks = runs
    tracked = [tracked_labels(task) for task in tasks]
    weighted = [tracked_labels(task, weighted=True) for task in tasks]
    true = [true_labels(task) for task in tasks]
    old = old_labels(setup.old_states("towel"), tracked)
    assert len({digest_of(each) for each in (tracked, weighted, true, old)}) == 4
    assert digest_of(tracked) == digest_of([tracked_labels(task) for task in tasks])
    for task, ours, known in zip(tasks, tracked, true, strict=True):
        assert ours.frames == known.frames == (0, read_recording(task.trajectory.recording)
                                               .actions[0].last_frame)  # fmt: skip
        mesh, labels = kept_labels(task.file.with_suffix(".npz"))
        np.testing.assert_allclose(ours.pictures[1].positions, labels[0].vertices)
        np.testing.assert_allclose(label_mesh(task, labels[0].frame).vertices, labels[0].vertices)
        assert label_mesh(task, 1) is None
        truth = Truth.load(task.trajectory.truth)
        where = material_map(truth.canonical, truth.faces, np.asarray(mesh.canonical, float))
        wanted = material_points(truth.at(labels[0].frame), truth.faces, where)
        np.testing.assert_allclose(known.pictures[1].positions, wanted)
    assert [len(one.pictures) for one in old] == [len(one.pictures) for one in tracked]
    shirt = [replace(one, kind="tshirt") for one in tracked]
    with pytest.raises(InvalidConfigError, match="same kind"):
        old_labels(setup.old_states("towel"), shirt)


@pytest.mark.slow
def test_the_truth_has_no_error_and_its_look_alike_none_up_to_symmetry(runs):
    _, tasks = runs
    trajectory = tasks[0].trajectory
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


def test_gains_are_of_means_over_the_recordings_that_both_have():
    def row(variant, recording, chamfer, error):
        return {"variant": variant, "recording": recording, "stage": "after", "action": 1,
                "actions": 1, "chamfer_pc_m2": chamfer, "chamfer_label_m2": chamfer,
                "chamfer_surface_m2": chamfer, "error_symmetric_mm": error}  # fmt: skip

    rows = [
        row("before", "a", 4e-4, 40.0), row("before", "b", 2e-4, 20.0),
        row("before", "c", 9e-4, 90.0), row("labels: default, weighted", "a", 2e-4, 24.0),
        row("labels: default, weighted", "b", 1e-4, 12.0),
        row("labels: the truth", "a", 1e-4, 20.0), row("labels: the truth", "b", 1e-4, 10.0),
    ]  # fmt: skip
    text = learning_columns.gains(rows)
    assert "| labels: default, weighted | 50 | 50 | 50 | 40 |" in text
    assert "| labels: the truth | 67 | 67 | 67 | 50 |" in text
    assert "+20 %" in text
