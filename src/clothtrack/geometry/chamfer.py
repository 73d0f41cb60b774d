"""Chamfer distances between point sets, as means of squared distances [m^2]."""

import numpy as np
from jaxtyping import Float
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
