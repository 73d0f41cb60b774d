"""Every kind changes a recording by its seed alone, and a harmless one leaves it valid."""

import json
from dataclasses import replace

import numpy as np
import pytest
from shared.drawn_films import LOWEST_M, SCENES, SPACING_M, draw
from shared.wrong_inputs import HARMLESS, WRONG

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.store import read_recording


@pytest.fixture(scope="module")
def film():
    """A drawn film that has what every kind needs."""
    return draw(replace(SCENES["soft_drape"], width=160), template_vertices=300)


def content(data):
    """Everything that the package is given."""
    arrays = [data.color, data.depth, data.mask, data.vertices, *data.picker.values()]
    return [json.dumps(data.document, sort_keys=True), *(one.tobytes() for one in arrays)]


@pytest.mark.parametrize("kind", [*WRONG, *HARMLESS], ids=lambda kind: kind.name)
def test_a_kind_changes_a_copy_by_its_seed_alone(kind, film, tmp_path):
    before = content(film)
    (changed, strength), (again, _) = (kind(film, np.random.default_rng(3)) for _ in range(2))
    assert content(film) == before
    assert (content(changed) != before) == (kind.name != "unchanged")
    assert content(changed) == content(again)
    assert kind.low <= strength <= kind.high
    assert len(changed.moments) == changed.count
    folder = changed.write(tmp_path / "recording")
    if kind in HARMLESS:
        read_recording(folder)


@pytest.mark.parametrize("name", SCENES)
def test_the_lengths_of_a_drawn_cloth_stay_and_it_stays_above_the_table(name):
    scene = SCENES[name]
    side = np.arange(-0.5 * scene.size_m[0], 0.5 * scene.size_m[0], 0.5 * SPACING_M)
    line = np.column_stack([side, np.full(len(side), 0.3 * scene.size_m[1])])
    for time_s in np.linspace(0.0, scene.times[-1], 12):
        placed = scene.positions(line, time_s)
        lengths = np.linalg.norm(np.diff(placed, axis=0), axis=1)
        assert np.abs(lengths / (0.5 * SPACING_M) - 1.0).max() < 0.02
        assert placed[:, 2].min() > LOWEST_M - 1e-9


def test_the_truth_of_a_film_lies_where_its_depth_was_measured(film):
    pinhole = {key: film.camera[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    camera = Camera("camera", **pinhole, world_from_camera=film.pose)
    pixels, far = camera.project(film.truth[-1])
    columns, rows = np.round(pixels).astype(int).T
    depth = film.camera["depth_unit_m"] * film.depth[-1][rows, columns]
    seen = film.mask[-1][rows, columns] & (depth > 0)
    # What lies over a vertex is nearer; noise and rounding are some millimeters.
    assert np.quantile((depth - far)[seen], 0.98) < 0.006
    assert np.median(np.abs(depth - far)[seen]) < 0.002
