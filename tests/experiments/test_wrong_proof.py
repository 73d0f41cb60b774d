"""Drawn films know their truth, every wrong input is wrong, and a few cases run end to end."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shared import drawn_films, wrong_proof
from shared.drawn_films import LAYER_M, LOWEST_M, SCENES, draw, project, rasterize, sheet
from shared.harmless_inputs import HARMLESS
from shared.proof_bases import BASES, Base, MissingBaseError, _drawn, load
from shared.recording_data import RecordingData, read_folder
from shared.wrong_inputs import KINDS

from clothtrack.recordings import read_recording

ROOT = Path(__file__).parents[2]
SMALL = {
    "color": {"name": "stiff_loop"},
    "color, no mask": {"name": "drag", "color": "green"},
    "two actions": {"name": "two_folds", "template": True},
    "template": {"name": "soft_drape", "template": True},
}


@pytest.fixture(scope="module")
def films():
    """The drawn recordings that the kinds need between them, in small pictures."""
    usual = dict(SCENES)
    SCENES.update({name: replace(scene, width=160) for name, scene in usual.items()})
    try:
        return {key: _drawn(**words)(Path()) for key, words in SMALL.items()}
    finally:
        SCENES.update(usual)


def film_for(kind, films):
    if "two actions" in kind.needs or "template" in kind.needs:
        return films["two actions" if "two actions" in kind.needs else "template"]
    return films["color"]


@pytest.mark.parametrize("name", SCENES)
def test_the_lengths_of_a_drawn_cloth_stay_and_it_stays_above_the_table(name):
    scene = SCENES[name]
    # Fine enough for the chords of the narrowest arc.
    grid, faces = sheet(scene.size_m, 0.0015)
    flat = np.linalg.norm(grid[faces[:, 0]] - grid[faces[:, 1]], axis=1)
    for time_s in np.linspace(0.0, scene.times[-1], 12):
        placed = scene.positions(grid, time_s)
        edges = np.linalg.norm(placed[faces[:, 0]] - placed[faces[:, 1]], axis=1)
        assert np.abs(edges / flat - 1.0).max() < 0.02
        assert placed[:, 2].min() > LOWEST_M - 1e-9


def test_a_stiff_loop_is_as_high_as_stated_and_lies_still_on_its_lower_layer():
    scene = SCENES["stiff_loop"]
    (fold,) = scene.moves
    grid, _ = sheet(scene.size_m, 0.002)
    ended = [scene.positions(grid, time_s) for time_s in (fold.end_s, fold.end_s + 1.0)]
    np.testing.assert_allclose(*ended, rtol=0.0, atol=1e-12)
    assert ended[0][:, 2].max() == pytest.approx(LOWEST_M + fold.loop_m, abs=2e-4)
    along = grid @ np.array(fold.normal) - fold.offset_m
    assert ended[0][along.argmax(), 2] == pytest.approx(LOWEST_M + LAYER_M, abs=1e-6)


@pytest.mark.parametrize("name", ["stiff_loop", "half_fold", "drag"])
def test_the_truth_of_a_film_lies_where_its_depth_was_measured(name):
    """Every vertex that no nearer thing hides is at the depth of its pixel."""
    scene = replace(SCENES[name], width=320)
    film = draw(scene)
    for frame in (0, 9, scene.frames - 1):
        pixels, z = project(scene, film.positions[frame])
        columns, rows = np.round(pixels).astype(int).T
        seen = film.mask[frame][rows, columns]
        gap = film.exact[frame][rows, columns] - z
        # What is nearer hides a vertex, and nothing is seen through the cloth; at its rim and on
        # steep cloth the pixel that is nearest to a vertex may show what is behind it.
        assert np.quantile(gap[seen], 0.98) < 0.004
        visible = seen & (gap > -0.004)
        assert visible.sum() > 0.4 * len(z)
        assert np.median(np.abs(gap[visible])) < 0.0006
        known = film.mask[frame] & (film.depth[frame] > 0)
        noise = (1e-3 * film.depth[frame] - film.exact[frame])[known]
        # Rounding to whole millimeters adds 0.3 mm.
        assert noise.std() == pytest.approx(np.hypot(scene.noise_m, 1e-3 / np.sqrt(12)), rel=0.05)
        assert abs(noise.mean()) < 1e-4


def test_a_triangle_is_drawn_at_the_depth_of_its_plane():
    corners = np.array([[[2.2, 1.3], [17.6, 3.1], [5.4, 12.8]]])
    depths = np.array([[0.5, 0.9, 0.7]])
    near, face = rasterize(corners, depths, np.full((16, 20), 4.0))
    # In the picture 1 / z is a plane through the corners.
    plane = np.linalg.solve(np.column_stack([corners[0], np.ones(3)]), 1.0 / depths[0])
    rows, columns = np.nonzero(face == 0)
    assert len(rows) == pytest.approx(
        0.5 * abs(np.linalg.det(corners[0, 1:] - corners[0, 0])), abs=8
    )
    expected = 1.0 / (np.column_stack([columns, rows, np.ones(len(rows))]) @ plane)
    np.testing.assert_allclose(near[face == 0], expected, rtol=1e-12)
    assert (near[face < 0] == 4.0).all()


def test_of_two_triangles_the_nearer_is_seen():
    corners = np.array([[[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]] * 2)
    near, face = rasterize(corners, np.array([[0.8] * 3, [0.6] * 3]), np.full((10, 10), 4.0))
    assert set(np.unique(face)) == {-1, 1}
    assert near[2, 2] == pytest.approx(0.6)


def test_a_recording_is_written_and_read_as_it_was(films, tmp_path):
    for key, data in films.items():
        again = read_folder(data.write(tmp_path / key.replace(" ", "_")))
        for name in ("color", "depth", "mask", "vertices", "faces", "canonical", "times"):
            np.testing.assert_array_equal(getattr(again, name), getattr(data, name))
        read_recording(tmp_path / key.replace(" ", "_"))
        data.save(tmp_path / "kept.npz")
        kept = RecordingData.load(tmp_path / "kept.npz")
        np.testing.assert_array_equal(kept.truth, data.truth)
        assert kept.document == data.document


def content(data):
    """Everything that the package is given."""
    arrays = [data.color, data.depth, data.mask, data.vertices, data.faces, data.canonical]
    return [
        json.dumps(data.document, sort_keys=True),
        *(None if one is None else one.tobytes() for one in arrays),
        *(cloud.tobytes() for cloud in data.clouds),
        *(samples.tobytes() for samples in data.picker.values()),
    ]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_every_wrong_kind_changes_the_recording_and_by_its_seed_alone(kind, films, tmp_path):
    data = film_for(kind, films)
    before = content(data)
    changed, strength = kind(data, np.random.default_rng(3))
    again, _ = kind(data, np.random.default_rng(3))
    assert content(data) == before
    assert content(changed) != before
    assert content(changed) == content(again)
    assert kind.low <= strength <= kind.high
    assert len(changed.moments) == changed.count
    changed.write(tmp_path / "recording")


@pytest.mark.parametrize("kind", HARMLESS, ids=lambda kind: kind.name)
def test_every_harmless_kind_leaves_a_valid_recording(kind, films, tmp_path):
    data = film_for(kind, films)
    changed, _ = kind(data, np.random.default_rng(3))
    read_recording(changed.write(tmp_path / "recording"))
    assert (content(changed) != content(data)) == (kind.name != "unchanged")
    # The truth is where the picture shows it, whatever world it is stated in.
    assert changed.truth is not None
    assert len(changed.moments) == changed.count


def test_there_are_as_many_kinds_and_recordings_as_promised():
    assert len({kind.name for kind in KINDS}) == len(KINDS) >= 45
    assert len({base.name for base in BASES}) == len(BASES) >= 8
    for proof in (wrong_proof.WRONG, wrong_proof.HARMLESS_PROOF):
        for kind in proof.kinds:
            assert kind.text
            assert any(kind.needs <= base.has for base in proof.bases), kind.name


def test_a_base_that_is_not_here_is_skipped_with_a_reason(tmp_path):
    (hanging,) = (base for base in BASES if base.name == "hanging")
    with pytest.raises(MissingBaseError, match="--data"):
        load(hanging, tmp_path)
    proof = wrong_proof.Proof(HARMLESS[:1], [hanging], wrong=False)
    row = proof.case(0, 0, tmp_path, tmp_path)
    assert row["outcome"] == "skipped"
    assert "skipped" in proof.markdown([row])


def test_false_trust_and_false_alarm_are_told_from_right_verdicts():
    row = {"outcome": "judged", "word": "trust", "mean_mm": 3.0, "p95_mm": 9.0}
    wrong, harmless = wrong_proof.WRONG, wrong_proof.HARMLESS_PROOF
    assert not wrong.violates(row)
    assert wrong.violates({**row, "mean_mm": 8.5})
    assert wrong.violates({**row, "p95_mm": 31.0})
    assert not wrong.violates({**row, "word": "look", "mean_mm": 80.0})
    assert not harmless.violates(row)
    assert harmless.violates({**row, "word": "look"})
    assert not harmless.violates({**row, "word": "look", "mean_mm": 6.0})
    assert not harmless.violates({**row, "word": "look", "mean_mm": None})
    refused = {"outcome": "refused"}
    assert harmless.violates(refused)
    assert not wrong.violates(refused)
    for ended in ("crashed", "did not end"):
        assert wrong.violates({"outcome": ended})


def test_a_right_film_is_tracked_and_its_error_is_that_of_its_truth(tmp_path, monkeypatch):
    """In this process: a shift of the truth shows in the error, millimeter by millimeter."""
    scene = replace(SCENES["soft_drape"], width=240)
    monkeypatch.setitem(drawn_films.SCENES, "soft_drape", scene)
    data = _drawn("soft_drape", template=True)(tmp_path)
    row = wrong_proof._tracked(data.write(tmp_path / "right"), data)
    assert row["word"] == "trust"
    assert row["mean_mm"] < 5.0
    data.truth = data.truth + (0.0, 0.0, 0.5)
    moved = wrong_proof._tracked(tmp_path / "right", data)
    assert moved["mean_mm"] == pytest.approx(500.0, abs=5.0)
    assert wrong_proof.WRONG.violates(moved)


@pytest.mark.slow
def test_a_few_cases_run_and_are_not_done_twice(tmp_path):
    """In a process of its own: it forks, which one that has computed must not."""
    script = ROOT / "experiments" / "tables" / "reliability.py"
    words = [script, "--smoke", "--out", tmp_path, "--only", "wrong", "harmless"]
    environment = dict(os.environ, PYTHONPATH=str(ROOT / "src"), OMP_NUM_THREADS="1")
    rows = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, *map(str, words)],
            env=environment, capture_output=True, text=True, check=False, timeout=900,
        )  # fmt: skip
        # 1: a case shows a false trust or a false alarm.
        assert done.returncode in (0, 1), done.stderr[-2000:]
        assert "| all |" in done.stdout
        rows.append({path.name: path.read_text() for path in tmp_path.glob("*.jsonl")})
    assert rows[0] == rows[1]
    read = [json.loads(line) for text in rows[0].values() for line in text.splitlines()]
    assert {row["outcome"] for row in read} <= {"judged", "refused", "skipped"}


def test_a_base_has_what_it_says(films):
    for base in BASES:
        assert isinstance(base, Base)
    assert films["color"].mask is not None
    assert films["color, no mask"].mask is None
    assert films["template"].vertices is not None
    assert len(films["two actions"].document["actions"]) == 2
