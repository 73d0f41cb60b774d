"""A garment fitted to a synthetic flat cloud finds its place and measures its size."""

from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import ClothDescription, Recording, Table
from clothtrack.simulation.garments import garment
from clothtrack.tracking.first_mesh import FirstMeshConfig, first_mesh

TABLE = Table(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1.0]))
CAMERA = Camera("top", 640, 480, 600.0, 600.0, 320.0, 240.0)


def recording(cloth: ClothDescription, table: Table | None = TABLE) -> Recording:
    return Recording(Path("flat"), (CAMERA,), {"top": 1e-3}, (), (), {}, table=table, cloth=cloth)


def cloud(points: np.ndarray) -> Observation:
    return Observation(points, (CAMERA,), {}, None, np.zeros((0, 3)), 0.0)


def laid_out(kind: str, size_m: tuple[float, float], angle: float) -> np.ndarray:
    """The upper layer of a flat garment, turned and shifted on the table, with 1 mm noise."""
    rng = np.random.default_rng(0)
    mesh = garment(kind, vertex_count=4000, size_m=size_m, seed=3)
    points = mesh.vertices[mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-4].copy()
    cosine, sine = np.cos(angle), np.sin(angle)
    points[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]]) + (0.05, -0.02)
    points[:, 2] = 0.104
    return points + rng.normal(scale=1e-3, size=points.shape)


@pytest.mark.parametrize(("size_m", "angle"), [((0.30, 0.20), 0.4), ((0.25, 0.25), -1.0)])
def test_a_towel_is_measured_within_two_percent(size_m: tuple[float, float], angle: float) -> None:
    points = laid_out("towel", size_m, angle)
    mesh = first_mesh(recording(ClothDescription("towel")), cloud(points), FirstMeshConfig())
    assert np.sqrt(mesh.vertex_areas.sum()) == pytest.approx(np.sqrt(np.prod(size_m)), rel=0.02)
    np.testing.assert_allclose(mesh.vertices[:, :2].mean(axis=0), (0.05, -0.02), atol=3e-3)
    assert mesh.vertices[:, 2].min() == pytest.approx(0.1 + FirstMeshConfig().resting_height_m)


@pytest.mark.parametrize("angle", [0.3, 2.0, -2.5])
def test_a_shirt_is_found_whichever_way_it_lies(angle: float) -> None:
    size_m = (0.46, 0.40)
    points = laid_out("tshirt", size_m, angle)
    mesh = first_mesh(recording(ClothDescription("tshirt")), cloud(points), FirstMeshConfig())
    fitted_size = np.ptp(mesh.canonical[:, :2], axis=0)
    np.testing.assert_allclose(fitted_size, size_m, rtol=0.03)
    # The neck must point where the shirt's neck points: its own +y direction, turned.
    top = mesh.vertices[mesh.canonical[:, 1] > 0.45 * fitted_size[1] - 0.03].mean(axis=0)
    direction = top[:2] - mesh.vertices[:, :2].mean(axis=0)
    direction /= np.linalg.norm(direction)
    assert direction @ (-np.sin(angle), np.cos(angle)) > 0.95


def test_a_stated_size_is_not_fitted() -> None:
    cloth = ClothDescription("towel", size_m=(0.30, 0.20))
    points = laid_out("towel", (0.31, 0.21), 0.4)
    mesh = first_mesh(recording(cloth), cloud(points), FirstMeshConfig())
    np.testing.assert_allclose(np.ptp(mesh.canonical[:, :2], axis=0), (0.30, 0.20), rtol=1e-6)


def test_the_template_wins() -> None:
    template = garment("towel", vertex_count=500)
    mesh = first_mesh(
        recording(ClothDescription("towel", template=template)),
        cloud(np.zeros((0, 3))),
        FirstMeshConfig(),
    )
    assert mesh is template


@pytest.mark.parametrize(
    ("cloth", "table", "points", "message"),
    [
        (ClothDescription("other"), TABLE, 500, "cloth.kind"),
        (ClothDescription("towel"), None, 500, "no table"),
        (ClothDescription("towel"), TABLE, 5, "5 points"),
    ],
)
def test_says_what_is_missing(
    cloth: ClothDescription, table: Table | None, points: int, message: str
) -> None:
    with pytest.raises(InvalidRecordingError, match=message):
        first_mesh(recording(cloth, table), cloud(np.zeros((points, 3))), FirstMeshConfig())
