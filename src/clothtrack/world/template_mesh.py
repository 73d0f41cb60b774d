"""Where the flat garment lies before anybody moves it, and the first mesh that a tracker gets.

That mesh has another triangulation than the world's cloth, is misplaced, mis-scaled and noisy, as
a first mesh measured by hand would be.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.garments import GarmentKind, garment
from clothtrack.world.flex import CONTACT_RADIUS_M


@dataclass(frozen=True)
class TemplateConfig:
    """The first mesh that a recording carries, and how wrong it is.

    Attributes:
        vertex_count: about how many vertices.
        shift_m: length of its misplacement in the table's plane [m].
        turn_deg: standard deviation of its turn about the vertical [deg].
        scale: standard deviation of its relative error of size.
        noise_m: standard deviation of independent noise of each vertex along x and along y [m].
    """

    vertex_count: int = 1500
    shift_m: float = 0.002
    turn_deg: float = 0.6
    scale: float = 0.005
    noise_m: float = 0.0005


def random_pose(rng: np.random.Generator) -> Float[np.ndarray, "2 3"]:
    """A turn about the vertical and a place on the table [m], near the middle of the picture."""
    angle = np.radians(rng.uniform(-12.0, 12.0))
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = rng.uniform(-0.02, 0.02, 2)
    return np.array([[cosine, -sine, x], [sine, cosine, y]])


def laid_down(
    mesh: ClothMesh, pose: Float[np.ndarray, "2 3"], height_m: float = CONTACT_RADIUS_M
) -> ClothMesh:
    """The flat garment on the table, its lowest vertex at this height [m]: at rest there."""
    vertices = np.empty(mesh.vertices.shape)
    vertices[:, :2] = mesh.vertices[:, :2] @ pose[:, :2].T + pose[:, 2]
    vertices[:, 2] = mesh.vertices[:, 2] - mesh.vertices[:, 2].min() + height_m
    return mesh.with_vertices(vertices)


def template_mesh(
    kind: GarmentKind,
    seed: int,
    wrong: TemplateConfig,
    *,
    size_m: tuple[float, float] | None,
    laid: Callable[[ClothMesh], ClothMesh],
    rng: np.random.Generator,
) -> ClothMesh:
    """The tracker's first mesh: another triangulation, wrong as `TemplateConfig` says.

    Args:
        kind: the garment.
        seed: of its triangulation.
        wrong: how wrong it is.
        size_m: width and length of the garment [m]; usual for its kind when None.
        laid: lays a flat garment on the table where the true one lies.
        rng: source of the errors.
    """
    mesh = garment(
        kind,
        vertex_count=wrong.vertex_count,
        size_m=size_m,
        pattern="alternating",
        seed=2 * seed + 1,
    )
    vertices = laid(mesh).vertices
    angle = np.radians(wrong.turn_deg) * rng.standard_normal()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    scale = 1.0 + wrong.scale * rng.standard_normal()
    heading = rng.uniform(0.0, 2.0 * np.pi)
    shift = wrong.shift_m * np.array([np.cos(heading), np.sin(heading)])
    middle = vertices[:, :2].mean(axis=0)
    noise = wrong.noise_m * rng.standard_normal((len(vertices), 2))
    vertices[:, :2] = scale * (vertices[:, :2] - middle) @ turn.T + middle + shift + noise
    return mesh.with_vertices(vertices)
