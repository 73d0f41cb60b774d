"""Random points on a surface, and Chamfer distances as means of squared distances [m^2]."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidConfigError


def one_way(
    points_from: Float[np.ndarray, "points 3"], points_to: Float[np.ndarray, "others 3"]
) -> float:
    """Return the mean squared distance [m^2] of each point to the nearest of the other points."""
    if not len(points_from) or not len(points_to):
        raise InvalidConfigError(
            f"Chamfer distance between {len(points_from)} and {len(points_to)} points; "
            "both sets need at least one"
        )
    distances, _ = cKDTree(points_to).query(points_from)
    return float(np.mean(np.square(distances)))


def two_way(
    points_a: Float[np.ndarray, "points 3"], points_b: Float[np.ndarray, "others 3"]
) -> float:
    """Return the sum of both one-way distances [m^2] (paper: "Chamfer"); RMS: root of its half."""
    return one_way(points_a, points_b) + one_way(points_b, points_a)


def sample_surface(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    count: int,
    seed: int,
) -> Float[np.ndarray, "points 3"]:
    """Draw points [m] uniformly over the area of a triangle mesh; a seed gives the same points."""
    rng = np.random.default_rng(seed)
    a, b, c = np.moveaxis(np.asarray(vertices, np.float64)[faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(faces), size=count, p=areas / areas.sum())
    # The square root makes the density uniform in the triangle (R. Osada et al.,
    # "Shape distributions", 2002, doi:10.1145/571647.571648).
    across = np.sqrt(rng.random((count, 1)))
    along = rng.random((count, 1))
    return (1 - across) * a[chosen] + across * (1 - along) * b[chosen] + across * along * c[chosen]
