import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.chamfer import sample_surface
from clothtrack_lab.published_networks.canonical_frame import canonical_frame
from clothtrack_lab.published_networks.network_config import preset
from clothtrack_lab.published_networks.surface import extract_surface, field_grid

igl = pytest.importorskip("igl")

SMALL = preset("small")


def rim_loops(faces):
    """Closed chains of edges that belong to one face only."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(sides, axis=0, return_counts=True)
    left = {}
    for a, b in edges[counts == 1].tolist():
        left.setdefault(a, []).append(b)
        left.setdefault(b, []).append(a)
    assert all(len(ends) == 2 for ends in left.values())
    loops = 0
    while left:
        loops += 1
        stack = [next(iter(left))]
        while stack:
            stack.extend(left.pop(stack.pop(), []))
    return loops


def exact_field(mesh, kind, config=SMALL):
    """The generalized winding number of a canonical pose (A. Jacobson et al., 2013)."""
    frame = canonical_frame(kind)
    grid = field_grid(frame, config)
    numbers = igl.fast_winding_number(
        mesh.canonical.astype(np.float64), mesh.faces.astype(np.int64), frame.to_meters(grid.nodes)
    )
    return numbers.reshape(grid.shape)


@pytest.fixture(scope="module", params=["tshirt", "towel"])
def garment_and_field(request):
    mesh = garment(request.param, vertex_count=800)
    return request.param, mesh, exact_field(mesh, request.param)


OPENINGS = {"tshirt": 4, "towel": 1}


@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_openings_stay_open_and_nothing_else_opens(garment_and_field, blur):
    kind, mesh, field = garment_and_field
    field = gaussian_filter(field, blur) if blur else field
    surface = extract_surface(field, canonical_frame(kind), SMALL)
    assert surface.status == "surface"
    assert rim_loops(surface.mesh.faces) == OPENINGS[kind]
    truth = sample_surface(mesh.canonical, mesh.faces, 4000, 0)
    found = sample_surface(surface.mesh.vertices, surface.mesh.faces, 4000, 1)
    # Two samplings of one surface of 0.3 m^2 are some 4 mm apart already.
    assert cKDTree(found).query(truth)[0].mean() < 0.007
    assert cKDTree(truth).query(found)[0].mean() < 0.007


def test_the_mesh_has_the_wanted_size_no_slivers_and_faces_outward(garment_and_field):
    kind, mesh, field = garment_and_field
    surface = extract_surface(field, canonical_frame(kind), SMALL).mesh
    assert surface.vertex_count < 1.2 * SMALL.surface_vertices
    assert surface.edge_lengths.min() > 0.05 * np.median(surface.edge_lengths)
    np.testing.assert_array_equal(surface.canonical, surface.vertices)
    nearest = cKDTree(mesh.canonical).query(surface.vertices)[1]
    ours, theirs = (normals(one) for one in (surface, ClothLike(mesh.canonical, mesh.faces)))
    agree = np.einsum("vi,vi->v", ours, theirs[nearest])
    assert (agree > 0).mean() > 0.97


class ClothLike:
    def __init__(self, vertices, faces):
        self.vertices, self.faces = vertices, faces


def normals(mesh):
    corners = mesh.vertices[mesh.faces]
    of_face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    found = np.zeros(mesh.vertices.shape)
    np.add.at(found, mesh.faces.ravel(), np.repeat(of_face, 3, axis=0))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", ["tshirt", "towel"])
def test_an_empty_field_has_no_surface_and_says_so(kind):
    frame = canonical_frame(kind)
    surface = extract_surface(np.zeros(field_grid(frame, SMALL).shape), frame, SMALL)
    assert surface.mesh is None
    assert surface.status.startswith("no surface: winding numbers from 0.00 to 0.00")
