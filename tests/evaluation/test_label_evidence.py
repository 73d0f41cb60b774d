"""What is observed of a label: closed forms, and nothing that only the truth could tell."""

import numpy as np
import pytest

from clothtrack.evaluation import label_evidence as module
from clothtrack.evaluation import label_quality
from clothtrack.evaluation.label_evidence import (
    Label,
    label_evidence,
)
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.recording import Table
from clothtrack.recordings.store import RecordingWriter, read_recording

HEIGHT_M = 0.6
DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
DOWN[2, 3] = HEIGHT_M
CAMERA = Camera("top", 320, 240, 440.0, 440.0, 159.5, 119.5, DOWN)
WIDTH_M = 0.24
SHEET = towel(WIDTH_M, 0.16, 0.01)
FLAT = SHEET.vertices + [0.0, 0.0, 0.0015]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two frames of a flat towel, seen without noise from above."""
    folder = tmp_path_factory.mktemp("recording") / "flat"
    flat_table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    view = Rasterizer(SHEET.faces, CAMERA).render(FLAT)
    shown = view.faces >= 0
    depth = np.where(shown, view.depth, HEIGHT_M)
    with RecordingWriter(folder, [CAMERA], {"top": 0.0001}, table=flat_table) as film:
        for index in range(2):
            film.add_frame(0.1 * index, depth={"top": depth}, mask={"top": shown})
    return read_recording(folder)


def look_at(recording, vertices, before=None):
    label = Label(1, vertices, vertices if before is None else before)
    (found,) = label_evidence(SHEET, [label], recording)
    return found


def test_a_mesh_is_left_behind_where_the_cloth_is_seen_elsewhere_later(recording):
    here = module.misfit_at(SHEET, FLAT, recording, 1)
    assert here.patch_m.max() < label_quality.FAR_M
    turned = FLAT.copy()
    turned[:, 0] = np.minimum(turned[:, 0], turned[:, 0].max() - 0.06)
    elsewhere = module.misfit_at(SHEET, turned, recording, 1)
    far = elsewhere.patch_m > label_quality.FAR_M
    assert 0.05 < far.mean() < 0.6
    assert FLAT[far, 0].min() > FLAT[:, 0].min() + 0.06


def test_the_right_mesh_has_little_against_it(recording):
    found = look_at(recording, FLAT)
    assert found.silhouette_gap < 0.02
    assert found.cloud_gap_m < 2e-4
    assert found.mesh_gap_m < 0.004
    assert found.edge_strain_p95 == pytest.approx(0.0, abs=1e-6)
    assert found.travelled_m == pytest.approx(0.0015)
    assert (found.crossing_rate, found.final_shift_m, found.share_hidden) == (0, 0, 0)
    assert found.action == 1


def test_the_further_a_mesh_is_off_its_cloud_the_worse_it_looks(recording):
    found = [look_at(recording, FLAT + [way, 0.0, 0.0]) for way in (0.0, 0.005, 0.01, 0.02)]
    for name in ("silhouette_gap", "cloud_gap_m", "travelled_m"):
        values = [one.as_dict()[name] for one in found]
        assert values == sorted(values), name
        assert values[-1] > 3.0 * values[0], name
    # Of the vertices more than one in ten must leave the cloud before this one says anything.
    assert found[-1].mesh_gap_m == pytest.approx(found[0].mesh_gap_m, abs=2e-3)
    assert look_at(recording, FLAT + [0.06, 0.0, 0.0]).mesh_gap_m > 0.02
    lifted = look_at(recording, FLAT + [0.0, 0.0, 0.02])
    assert lifted.cloud_gap_m == pytest.approx(0.02, abs=2e-3)
    assert lifted.mesh_gap_m == pytest.approx(0.02, abs=2e-3)


def test_stretch_and_crossing_are_noticed(recording):
    stretched = look_at(recording, FLAT * [1.1, 1.1, 1.0])
    assert stretched.edge_strain_p95 == pytest.approx(0.1)
    bent = FLAT.copy()
    bent[FLAT[:, 0] > 0.0] *= [-1.0, 1.0, 1.0]
    bent[FLAT[:, 0] > 0.0] += [0.0, 0.003, 0.002]
    bent[FLAT[:, 0] > 0.06, 2] -= 0.004
    found = look_at(recording, bent)
    assert found.crossing_rate > 1.0
    assert found.share_hidden > 0.2
