import numpy as np
import pytest
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidRecordingError
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.view import cloth_pixels, crop, points_of
from clothtrack_lab.published_networks.network_config import preset

CONFIG = preset("small")


def tilted(degrees, *, place=(0.05, -0.12, 0.75), width=320):
    """A camera above the table, tilted about world x."""
    angle = np.radians(degrees)
    pose = np.eye(4)
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    pose[:3, :3] = turn @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = place
    return Camera("tilted", width, 240, 300.0, 300.0, width / 2 - 0.5, 119.5, pose)


def bumpy_towel():
    mesh = towel(0.28, 0.24, 0.01)
    vertices = mesh.vertices.copy()
    vertices[:, 2] = 0.01 + 0.008 * np.sin(25 * vertices[:, 0]) * np.cos(20 * vertices[:, 1])
    return mesh.with_vertices(vertices)


def picture(mesh, camera):
    depth = Rasterizer(mesh.faces, camera).render(mesh.vertices).depth
    return np.where(np.isfinite(depth), depth, 0.0)


@pytest.mark.parametrize("degrees", [0.0, 12.0])
def test_a_tilted_camera_gives_the_picture_of_the_camera_above(degrees):
    mesh, camera = bumpy_towel(), tilted(degrees)
    view = crop(picture(mesh, camera), None, camera, CONFIG)
    expected = picture(mesh, view.camera)
    both = view.mask & (expected > 0)
    # Only a rim of about a pixel of either picture may differ.
    assert both.sum() > 0.95 * (expected > 0).sum()
    assert (view.mask & ~both).sum() < 0.02 * both.sum()
    assert np.percentile(np.abs(view.depth - expected)[both], 99) < 1e-3


def test_pixels_of_the_canonical_picture_are_measured_points_of_the_cloth():
    mesh = bumpy_towel()
    view = crop(picture(mesh, tilted(8.0)), None, tilted(8.0), CONFIG)
    found = cloth_pixels(view.depth, CONFIG)
    assert (found.sources // CONFIG.output_stride == found.pixels).all()
    assert len(np.unique(found.pixels, axis=0)) == len(found.pixels)
    points = points_of(view.depth, view.camera, found.sources)
    everything = view.camera.back_project(view.depth)
    assert cKDTree(everything).query(points)[0].max() < 1e-9
    blocks = view.mask.reshape(64, 2, 64, 2).any(axis=(1, 3))
    assert len(found.pixels) == blocks.sum()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda depth: depth * 0.0, "0 pixels of cloth"),
        (lambda depth: depth * 1000.0, "millimeters"),
        (lambda depth: depth[:100], "320 x 100"),
        (lambda depth: np.kron(np.ones((60, 80)), np.pad([[0.7]], (0, 3))), "sparse"),
    ],
)
def test_unusable_depth_is_refused_with_the_reason(change, message):
    camera = tilted(0.0)
    with pytest.raises(InvalidRecordingError, match=message):
        crop(change(picture(bumpy_towel(), camera)), None, camera, CONFIG)
