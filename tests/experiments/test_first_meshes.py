"""Other first meshes of the same recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shared.first_meshes import resampled, with_first_mesh_error

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation import Truth
from clothtrack.garments import garment
from clothtrack.recordings import ClothDescription, Recording

SIZE = (0.2, 0.3)


@pytest.fixture(scope="module", params=["towel", "tshirt"])
def recording(request):
    mesh = garment(request.param, vertex_count=400, size_m=SIZE)
    template = mesh.with_vertices(1.02 * mesh.vertices + [0.1, 0.0, 0.01])
    cloth = ClothDescription(
        kind=request.param, size_m=SIZE, template=template, held_vertices={"gripper": np.array([3])}
    )
    return Recording(Path(), (), {}, (), (), {}, cloth=cloth)


def test_a_finer_first_mesh_lies_on_the_template(recording):
    old = recording.cloth.template
    new = resampled(recording, 900).cloth.template
    assert len(new.vertices) == pytest.approx(900, rel=0.15)
    # The template is a scaled and shifted garment: every material point must have gone along.
    flat = garment(recording.cloth.kind, vertex_count=900, size_m=SIZE)
    gap = np.linalg.norm(new.vertices - (1.02 * flat.vertices + [0.1, 0.0, 0.01]), axis=1)
    assert np.median(gap) < 0.001
    assert np.ptp(new.vertices, axis=0)[:2] == pytest.approx(np.ptp(old.vertices, axis=0)[:2], 0.02)
    assert resampled(recording, 900).cloth.held_vertices == {}


def test_the_first_mesh_moves_between_the_truth_and_beyond_itself(recording):
    fine = garment(recording.cloth.kind, vertex_count=600, size_m=SIZE, pattern="random", seed=1)
    truth = Truth(
        fine.vertices[None].astype(np.float64), fine.faces, np.zeros(1, int),
        np.asarray(fine.canonical, np.float64),
    )  # fmt: skip
    exact, same, twice = (
        with_first_mesh_error(recording, truth, factor).cloth.template.vertices
        for factor in (0.0, 1.0, 2.0)
    )
    template = recording.cloth.template.vertices
    np.testing.assert_allclose(same, template, atol=1e-6)
    np.testing.assert_allclose(twice - template, template - exact, atol=1e-6)
    assert np.linalg.norm(exact - template, axis=1).min() > 0.05


def test_a_recording_without_canonical_coordinates_is_refused(recording):
    bare = replace(recording, cloth=replace(recording.cloth, template=None))
    with pytest.raises(InvalidConfigError, match="canonical"):
        resampled(bare, 500)
