"""What cannot be a cloth is refused before anything is computed with it."""

import numpy as np
import pytest

from clothtrack.errors import InvalidMeshError
from clothtrack.geometry.mesh import ClothMesh

VERTICES = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
FACES = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("vertices", "faces", "told"),
    [
        (VERTICES[..., None], FACES, r"vertices are an array of shape \(3, 3, 1\)"),
        (VERTICES.T[:2].T, FACES, r"vertices are an array of shape \(3, 2\)"),
        (VERTICES.astype("U8"), FACES, "vertices are an array .* type <U8"),
        (VERTICES, FACES.astype(float), "faces are an array .* type float64"),
        (VERTICES, FACES[0], r"faces are an array of shape \(3,\)"),
        (VERTICES * 1e200, FACES, "1.0e\\+199 m from the origin .* scale the mesh to meters"),
    ],
)
def test_arrays_that_are_no_mesh_are_refused(vertices, faces, told):
    # As a user has it: what checks annotations in tests stands before our own check.
    mesh = object.__new__(ClothMesh)
    for name, value in (("vertices", vertices), ("faces", faces), ("canonical", None)):
        object.__setattr__(mesh, name, value)
    with pytest.raises(InvalidMeshError, match=told):
        ClothMesh.__post_init__(mesh)


def test_canonical_coordinates_are_meters_too():
    with pytest.raises(InvalidMeshError, match=r"canonical coordinate is 1.0e\+07 m"):
        ClothMesh(VERTICES, FACES, VERTICES * 1e8)


def test_canonical_coordinates_of_half_precision_are_read_without_a_warning():
    mesh = ClothMesh(VERTICES, FACES, VERTICES.astype(np.float16))
    assert mesh.canonical is not None
