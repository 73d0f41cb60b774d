"""The outline of a mesh: zero gap for the right place, and a slip that nearest points miss."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.alignment.silhouette import cloud_picture, silhouette_gap, slide_to_outline
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.chamfer import sample_surface
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Table

WIDTH_M = 0.2
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


@pytest.fixture
def camera() -> Camera:
    """Looks straight down from 0.6 m."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.6
    return Camera("above", 320, 240, 300.0, 300.0, 160.0, 120.0, pose)


@pytest.fixture
def mesh() -> ClothMesh:
    return towel(WIDTH_M, 0.14, 0.01)


@pytest.fixture
def observation(mesh, camera) -> Observation:
    cloud = sample_surface(mesh.vertices, mesh.faces, 6000, 0)
    return seen(cloud, camera)


def seen(cloud: np.ndarray, *cameras: Camera) -> Observation:
    return Observation(cloud, cameras, {}, None, np.zeros((0, 3)), 0.0)


def slipped(mesh: ClothMesh, shift_m: tuple[float, float], turn_rad: float) -> np.ndarray:
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return mesh.vertices @ turn.T + (*shift_m, 0.0)


def test_the_right_place_leaves_hardly_a_gap(mesh, observation):
    assert silhouette_gap(mesh, mesh.vertices, observation) < 0.05


@pytest.mark.parametrize("way", [0.02, 0.05, 0.08])
def test_two_rectangles_beside_each_other_have_the_overlap_of_two_rectangles(
    mesh, observation, way
):
    gap = silhouette_gap(mesh, slipped(mesh, (way, 0.0), 0.0), observation)
    assert gap == pytest.approx(2.0 * way / (WIDTH_M + way), abs=0.03)


@pytest.mark.parametrize("spacing", [1, 2, 5])
def test_a_cloud_covers_the_gaps_between_its_points_and_nothing_else(camera, spacing):
    depth = np.zeros((camera.height, camera.width))
    depth[60:161:spacing, 100:201:spacing] = 0.6
    covered = np.zeros(depth.shape, bool)
    covered[60:161, 100:201] = True
    points = camera.back_project(depth)
    np.testing.assert_array_equal(cloud_picture(points, camera), covered)
    assert not cloud_picture(points[:1], camera).any()


def test_what_no_camera_could_see_does_not_count(mesh, observation, camera):
    pixels, _ = camera.project(np.array([[0.09, 0.0, 0.0]]))
    arm = np.zeros((camera.height, camera.width), bool)
    arm[:, int(pixels[0, 0]) :] = True
    blind = replace(observation, hidden={camera.name: arm})
    moved = mesh.vertices.copy()
    moved[mesh.vertices[:, 0] > 0.095, 0] += 0.03
    assert silhouette_gap(mesh, moved, blind) < 0.05
    assert silhouette_gap(mesh, moved, observation) > 0.1


@pytest.mark.parametrize(("shift", "turn"), [((0.012, 0.0), 0.0), ((-0.006, 0.009), 0.05)])
def test_a_slip_is_undone(mesh, observation, shift, turn):
    vertices = slipped(mesh, shift, turn)
    before = np.linalg.norm(vertices - mesh.vertices, axis=1).mean()
    after = slide_to_outline(mesh, vertices, observation, TABLE)
    left = np.linalg.norm(after - mesh.vertices, axis=1).mean()
    assert left < 0.2 * before
    np.testing.assert_allclose(after[:, 2], 0.0, atol=1e-9)
    edges = np.linalg.norm(np.diff(after[mesh.edges], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(edges, mesh.edge_lengths, rtol=1e-6)
