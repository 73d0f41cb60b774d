"""Generalized winding numbers of a canonical mesh, the targets of the implicit decoder.

The winding number of a closed surface is 1 inside and 0 outside. That of an open one is the solid
angle that it subtends at the point, divided by 4 pi (A. Jacobson et al., "Robust inside-outside
segmentation using generalized winding numbers", 2013, doi:10.1145/2461912.2461916). Across a flat
sheet it jumps by one, from -1/2 to 1/2.
"""

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float, Int

from clothtrack.files.bounds import Checked, Count, Positive, Share
from clothtrack.geometry.closest_point import interpolate


@dataclass(frozen=True)
class WindingConfig(Checked):
    """The points at which a garment's field is computed, once for all its states.

    Attributes:
        pool: number of points per garment; a training example draws some of them.
        near_share: share of points near the surface; the others fill the unit cube. The paper's
            reference has none, and 98 % of its points are where the field is almost zero.
        near_spread: standard deviation of their distance to the surface along each axis
            [unit cube].
    """

    pool: Count = 32_768
    near_share: Share = 0.5
    near_spread: Positive = 0.05


@dataclass(frozen=True, eq=False)
class WindingPool:
    """The winding numbers of one garment at points in the unit cube."""

    points: Float[np.ndarray, "points 3"]
    values: Float[np.ndarray, " points"]


def winding_numbers(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    points: Float[np.ndarray, "points 3"],
) -> Float[np.ndarray, " points"]:
    """Return the generalized winding number of a mesh at each point, to about 1e-2."""
    found = igl.fast_winding_number(
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int64),
        np.ascontiguousarray(points, np.float64),
    )
    return np.asarray(found)


def winding_pool(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    config: WindingConfig,
    *,
    seed: int,
) -> WindingPool:
    """Return shuffled points in the unit cube and near the surface, with their winding numbers.

    Args:
        vertices: vertices of the canonical mesh [unit cube].
    """
    rng = np.random.default_rng(seed)
    near = round(config.near_share * config.pool)
    corners = np.asarray(vertices, np.float64)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(faces), size=near, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), size=near)
    surface = interpolate(weights, corners[chosen])
    spread = surface + config.near_spread * rng.standard_normal(surface.shape)
    points = np.concatenate([np.clip(spread, 0.0, 1.0), rng.random((config.pool - near, 3))])
    points = points[rng.permutation(len(points))]
    values = winding_numbers(vertices, faces, points)
    return WindingPool(points.astype(np.float32), values.astype(np.float32))
