"""A garment fitted to a synthetic flat cloud finds its place and measures its size."""

from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidMeshError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.flat_fit import flat_fit
from clothtrack.recordings.point_cloud import Observation, thin
from clothtrack.recordings.recording import ClothDescription, Recording, Table
from clothtrack.recordings.template_file import write_template
from clothtrack.simulation.parameters import RESTING_HEIGHT_M

TABLE = Table(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1.0]))
ABOVE = np.array([[1.0, 0, 0, 0], [0, -1.0, 0, 0], [0, 0, -1.0, 0.85], [0, 0, 0, 1.0]])
CAMERA = Camera("top", 640, 480, 600.0, 600.0, 319.5, 239.5, ABOVE)


def recording(cloth: ClothDescription, table: Table | None = TABLE) -> Recording:
    return Recording(Path("flat"), (CAMERA,), {"top": 1e-3}, (), (), {}, table=table, cloth=cloth)


def cloud(points: np.ndarray) -> Observation:
    return Observation(points, (CAMERA,), {}, None, np.zeros((0, 3)), 0.0)


def laid_out(kind: str, size_m: tuple[float, float], angle: float) -> np.ndarray:
    """What a camera sees of a flat garment, turned and shifted on the table: with noise, thinned.

    Every fiftieth pixel has no depth.
    """
    rng = np.random.default_rng(0)
    mesh = garment(kind, vertex_count=1000, size_m=size_m, seed=3)
    vertices = mesh.vertices + (0.0, 0.0, 0.104)
    cosine, sine = np.cos(angle), np.sin(angle)
    vertices[:, :2] = vertices[:, :2] @ np.array([[cosine, sine], [-sine, cosine]]) + (0.05, -0.02)
    depth = Rasterizer(mesh.faces, CAMERA).render(vertices).depth
    seen = np.isfinite(depth) & (rng.random(depth.shape) > 0.02)
    depth = np.where(seen, depth + rng.normal(scale=1e-3, size=depth.shape), 0.0)
    return thin(CAMERA.back_project(depth, seen), 0.004)


@pytest.mark.parametrize(("size_m", "angle"), [((0.30, 0.20), 0.4), ((0.25, 0.25), -1.0)])
def test_a_towel_is_measured_within_one_percent(size_m: tuple[float, float], angle: float) -> None:
    points = laid_out("towel", size_m, angle)
    mesh = flat_fit(recording(ClothDescription("towel")), cloud(points)).mesh
    sides = np.sort(np.ptp(mesh.canonical[:, :2], axis=0))
    np.testing.assert_allclose(sides, np.sort(size_m), rtol=0.01)
    np.testing.assert_allclose(mesh.vertices[:, :2].mean(axis=0), (0.05, -0.02), atol=1e-3)
    assert mesh.vertices[:, 2].min() == pytest.approx(0.1 + RESTING_HEIGHT_M)


@pytest.mark.parametrize("angle", [0.3, -2.5])
def test_a_shirt_is_found_whichever_way_it_lies(angle: float) -> None:
    size_m = (0.46, 0.40)
    points = laid_out("tshirt", size_m, angle)
    mesh = flat_fit(recording(ClothDescription("tshirt")), cloud(points)).mesh
    np.testing.assert_allclose(np.ptp(mesh.canonical[:, :2], axis=0), size_m, rtol=0.01)
    # Every vertex, and so the neck, is where the shirt's own coordinates say.
    cosine, sine = np.cos(angle), np.sin(angle)
    where = mesh.canonical[:, :2] @ np.array([[cosine, sine], [-sine, cosine]]) + (0.05, -0.02)
    assert np.linalg.norm(mesh.vertices[:, :2] - where, axis=1).max() < 4e-3


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
        flat_fit(recording(cloth, table), cloud(np.zeros((points, 3))))


def test_a_template_in_millimeters_is_told(tmp_path: Path) -> None:
    flat = garment("towel", vertex_count=100, size_m=(0.3, 0.2))
    file = tmp_path / "towel.npz"
    write_template(flat.with_vertices(1000.0 * flat.vertices), file)
    points = laid_out("towel", (0.3, 0.2), 0.4)
    with pytest.raises(InvalidMeshError, match=r"towel\.npz: .*150 m .* in meters"):
        flat_fit(recording(ClothDescription("towel")), cloud(points), template=str(file))
