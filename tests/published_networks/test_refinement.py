"""Fine-tuning a mesh against its own picture: each term does what it says, and no harm."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidMeshError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import edge_strain
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings.point_cloud import Observation, thin
from clothtrack.recordings.recording import Table
from clothtrack_lab.published_networks.refinement import (
    RefinementConfig,
    Refiner,
    consistent_displacement,
)

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 0.7
CAMERA = Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5, POSE)


def towel() -> ClothMesh:
    return garment("towel", vertex_count=400, size_m=(0.24, 0.18))


def lying(mesh: ClothMesh, shift=(0.0, 0.0)) -> np.ndarray:
    """The flat towel on the table with one corner bent upwards a little, so that it has a shape."""
    vertices = mesh.vertices.astype(np.float64) + (*shift, 0.0)
    vertices[:, 2] = 0.0015 + 0.4 * np.maximum(0.0, mesh.vertices[:, 0] - 0.07) ** 1.5
    return vertices


def filmed(mesh: ClothMesh, vertices: np.ndarray):
    """The cloud of a perfect camera, and its points with their true canonical coordinates."""
    drawn = Rasterizer(mesh.faces, CAMERA).render(vertices)
    seen = np.isfinite(drawn.depth)
    depth = np.where(seen, drawn.depth, 0.0)
    points = CAMERA.back_project(depth, seen)
    corners = mesh.faces[drawn.faces[seen]]
    a, b, c = np.moveaxis(vertices[corners], 1, 0)
    share = np.stack(
        [
            np.linalg.norm(np.cross(b - points, c - points), axis=1),
            np.linalg.norm(np.cross(c - points, a - points), axis=1),
            np.linalg.norm(np.cross(a - points, b - points), axis=1),
        ],
        axis=1,
    )
    share /= share.sum(axis=1, keepdims=True)
    canonical = np.einsum("pc,pcx->px", share, mesh.canonical[corners])
    cloud = Observation(thin(points, 0.004), (CAMERA,), {}, None, np.zeros((0, 3)), 0.0)
    return cloud, SeenPoints(points, canonical, np.ones(len(points)))


def mean_error_mm(found: np.ndarray, truth: np.ndarray) -> float:
    return 1e3 * float(np.linalg.norm(found - truth, axis=1).mean())


def test_a_slipped_mesh_is_brought_back_by_what_its_pieces_are() -> None:
    """Slid by 12 mm in its plane a towel hardly differs for nearest points; its pieces tell."""
    mesh = towel()
    truth = lying(mesh)
    cloud, seen = filmed(mesh, truth)
    start = mesh.with_vertices(lying(mesh, (0.009, -0.008)))
    assert mean_error_mm(start.vertices, truth) == pytest.approx(12.0, abs=0.5)
    config = RefinementConfig(rounds=3, consistency_rounds=2)
    with_pieces = Refiner(start, cloud, config, rest=mesh, table=TABLE).refine(seen)
    without = Refiner(start, cloud, config, rest=mesh, table=TABLE).refine()
    assert mean_error_mm(with_pieces.positions, truth) < 4.0
    assert mean_error_mm(without.positions, truth) > 6.0
    assert with_pieces.chosen > 0
    assert with_pieces.chamfer_m2[with_pieces.chosen] == min(with_pieces.chamfer_m2)
    # The solver has carried it there: a towel and no rubber.
    assert edge_strain(mesh, with_pieces.positions) < 0.01


def test_a_right_mesh_stays_where_it_is() -> None:
    mesh = towel()
    truth = lying(mesh)
    cloud, seen = filmed(mesh, truth)
    found = Refiner(mesh.with_vertices(truth), cloud, RefinementConfig(), rest=mesh, table=TABLE)
    assert mean_error_mm(found.refine(seen).positions, truth) < 1.0


def test_wrong_pieces_are_outvoted() -> None:
    mesh = towel()
    truth = lying(mesh)
    cloud, seen = filmed(mesh, truth)
    rng = np.random.default_rng(0)
    canonical = seen.canonical.copy()
    wrong = rng.random(len(canonical)) < 0.15
    canonical[wrong] = rng.permutation(canonical)[wrong]
    mixed = replace(seen, canonical=canonical)
    start = mesh.with_vertices(lying(mesh, (0.009, -0.008)))
    config = RefinementConfig(rounds=3, consistency_rounds=2)
    found = Refiner(start, cloud, config, rest=mesh, table=TABLE).refine(mixed)
    assert mean_error_mm(found.positions, truth) < 5.0


def test_consistency_minimizes_what_it_says() -> None:
    """The closed form is the minimum of its formula, robust weights held fixed."""
    mesh = towel()
    truth = lying(mesh)
    _, seen = filmed(mesh, truth)
    few = np.random.default_rng(1).choice(len(seen.points), 200, replace=False)
    seen = SeenPoints(seen.points[few], seen.canonical[few], np.linspace(0.2, 1.0, 200))
    start = mesh.with_vertices(lying(mesh, (0.006, 0.002)))
    config = RefinementConfig(outlier_m=1e3)
    found = consistent_displacement(start, seen, config)

    def objective(flat: np.ndarray) -> float:
        displacement = flat.reshape(-1, 3)
        x = start.vertices + displacement
        value = 0.0
        for point, canonical, weight in zip(
            seen.points, seen.canonical, seen.confidence, strict=True
        ):
            corners = mesh.canonical[mesh.faces]
            inside = _barycentric(canonical[:2], corners[:, :, :2])
            face = int(inside.min(axis=1).argmax())
            on_mesh = inside[face] @ x[mesh.faces[face]]
            value += weight * ((on_mesh - point) ** 2).sum()
        value *= config.consistency_weight / seen.confidence.sum()
        i, j = mesh.edges.T
        gap = displacement[i] - displacement[j]
        return value + config.rigidity_weight * (gap**2).sum(axis=1).mean()

    rng = np.random.default_rng(2)
    here = objective(found.ravel())
    assert here < objective(np.zeros(found.size))
    for _ in range(3):
        aside = rng.normal(scale=1e-3, size=found.size)
        up, down = objective(found.ravel() + aside), objective(found.ravel() - aside)
        # At a minimum of a quadratic function both ways are up, and equally so.
        assert min(up, down) > here
        assert abs(up - down) < 0.05 * (up + down - 2.0 * here)


def _barycentric(place: np.ndarray, corners: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(corners, 1, 0)
    whole = _cross(b - a, c - a)
    return (
        np.stack(
            [
                _cross(b - place, c - place),
                _cross(c - place, a - place),
                _cross(a - place, b - place),
            ],
            axis=1,
        )
        / whole[:, None]
    )


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


def test_another_garment_is_refused() -> None:
    mesh = towel()
    cloud, _ = filmed(mesh, lying(mesh))
    other = garment("towel", vertex_count=200)
    with pytest.raises(InvalidMeshError, match="made from"):
        Refiner(mesh, cloud, RefinementConfig(), rest=other)
