"""Truth files are read or refused, and material points are found across triangulations."""

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.truth import Truth, material_map, material_points
from clothtrack.garments.garment_meshes import towel, tshirt


@pytest.mark.parametrize("sewn", [towel(0.2, 0.3, 0.02), tshirt(spacing_m=0.025)])
def test_a_mesh_maps_to_itself(sewn):
    where = material_map(sewn.canonical, sewn.faces, sewn.canonical)
    moved = sewn.vertices + np.sin(7 * sewn.vertices[:, [1, 2, 0]])
    np.testing.assert_allclose(material_points(moved, sewn.faces, where), moved, atol=1e-9)


def test_an_affine_motion_is_found_exactly_on_another_triangulation(rng):
    coarse, fine = towel(0.3, 0.2, 0.03), towel(0.3, 0.2, 0.011, pattern="random")
    matrix, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    where = material_map(fine.canonical, fine.faces, coarse.canonical)
    found = material_points(fine.vertices @ matrix + shift, fine.faces, where)
    np.testing.assert_allclose(found, coarse.vertices @ matrix + shift, atol=1e-3)


def arrays():
    sheet = towel(0.1, 0.1, 0.02)
    return {
        "positions": np.stack([sheet.vertices, sheet.vertices + 1.0]),
        "faces": sheet.faces,
        "canonical": sheet.canonical,
        "frames": np.array([0, 7]),
    }


def test_truth_is_asked_by_frame_of_the_recording(tmp_path):
    known = arrays()
    np.savez(tmp_path / "fold.npz", **known)
    truth = Truth.load(tmp_path / "fold.npz")
    np.testing.assert_array_equal(truth.at(7), known["positions"][1])
    assert truth.at(3) is None


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"faces": None}, "no array 'faces'"),
        ({"frames": np.array([0])}, "positions has shape"),
        ({"faces": np.array([[0, 1, 999]])}, "faces must name"),
        ({"canonical": np.zeros((3, 3))}, "canonical has shape"),
        ({"positions": np.full((2, 36, 3), np.nan)}, "not finite"),
        ({"frames": np.array([None, None])}, "cannot be read"),
        ("hello", r"bad\.npz"),
    ],
)
def test_a_bad_truth_file_is_refused_by_name(tmp_path, change, told):
    if isinstance(change, str):
        (tmp_path / "bad.npz").write_text(change)
    else:
        content = {k: v for k, v in (arrays() | change).items() if v is not None}
        np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(InvalidResultError, match=told):
        Truth.load(tmp_path / "bad.npz")
