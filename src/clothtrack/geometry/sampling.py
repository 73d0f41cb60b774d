"""Random points on a surface."""

import numpy as np
from jaxtyping import Float, Int


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
