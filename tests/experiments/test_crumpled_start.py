"""Tracking from a crumpled first frame beside a start from the flat cloth."""

import json
from dataclasses import replace

import numpy as np
import pytest
from shared.learning_experiment import tiny_network
from tables import crumpled_start
from tables.crumpled_start import crumpled, errors_mm

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation import Truth
from clothtrack.garments import garment
from clothtrack.recordings import read_recording
from clothtrack_lab.world import SMALL_WORLD, simulate


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("crumpled")
    simulate(folder, "towel", 1, config=replace(SMALL_WORLD, actions=2))
    return folder


def test_a_folder_without_recordings_is_refused_in_one_line(tmp_path, capsys):
    assert crumpled_start.main(["--bench", str(tmp_path)]) == 1
    said = capsys.readouterr().err
    assert f"{tmp_path} has no recordings with truth" in said
    assert said.count("\n") == 1


def test_errors_are_those_of_the_look_alike_that_fits_best():
    flat = garment("towel", vertex_count=120, size_m=(0.3, 0.2))
    positions = np.asarray(flat.vertices, np.float64)
    truth = Truth(positions[None], flat.faces, np.array([7]), np.asarray(flat.canonical, float))
    turned = positions * (-1.0, -1.0, 1.0) + (0.0, 0.0, 0.01)
    assert errors_mm(flat, [(7, turned)], truth) == pytest.approx([10.0])


@pytest.mark.slow
def test_the_second_action_is_tracked_from_its_own_first_frame(bench, tmp_path, capsys):
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    (folder,) = (bench / "recordings").iterdir()
    recording = read_recording(folder)
    late = crumpled(recording)
    start = recording.actions[1].first_frame
    assert late.frames[0].time_s == recording.frames[start].time_s
    assert [one.index for one in late.frames] == list(range(len(late.frames)))
    assert late.actions[0].last_frame == recording.actions[1].last_frame - start
    assert late.cloth.template is None
    with pytest.raises(InvalidConfigError, match="crumpled start needs 2"):
        crumpled(late)
    weights = tiny_network(tmp_path / "tokens.safetensors", "towel")
    words = [
        "--bench",
        str(bench),
        "--weights",
        str(weights),
        "--json",
        str(tmp_path / "rows.json"),
    ]
    assert crumpled_start.main(words) == 0
    (row,) = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert len(row["flat_mm"]) == len(row["crumpled_mm"]) == 1
    printed = capsys.readouterr().out
    assert f"{row['crumpled_mm'][0]:.1f}" in printed
    (kept,) = (bench / "experiments" / "crumpled").iterdir()
    before = kept.stat().st_mtime_ns
    assert crumpled_start.main(words) == 0
    assert kept.stat().st_mtime_ns == before
