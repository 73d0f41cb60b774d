"""Anchor the mesh with feature tracks of the color pictures.

Optical flow follows points from picture to picture. At the start of an action they are bound to the
cloth; from then on they give the positions of these material points.
"""

import logging
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.alignment.aligner import Marks
from clothtrack.geometry.closest_point import closest_on_mesh, interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.tracking.protocols import State

logger = logging.getLogger(__name__)

NEAR_M = 0.006
"""A followed point farther than this [m] from the visible mesh is not bound to it."""

DOUBT_M = 0.02
"""A followed point this far from its material point [m] has weight 1/4 (Geman and McClure),
because it was tracked or bound wrongly."""

_MOST_BOUND = 4096
"""Maximum number of bound points; beyond it the oldest lost ones are dropped, because hours of
video keep adding new ones."""


class FeatureAnchors:
    """Feature tracks bound to a cloth, and the vertex targets that they give.

    Attributes:
        bound: the triangle and the barycentric weights of each point, by its number.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        visible: Callable[[Float[np.ndarray, "vertices 3"]], Bool[np.ndarray, " vertices"]],
    ) -> None:
        """Begin with nothing bound."""
        self._faces, self._visible = mesh.faces, visible
        self.bound: dict[int, tuple[int, np.ndarray]] = {}

    def bind(self, state: State, observation: Observation) -> None:
        """Bind the points that are followed here and not yet bound; lost ones may come back."""
        numbers = observation.followed.numbers
        fresh = np.array([number not in self.bound for number in numbers.tolist()], dtype=bool)
        positions = state.positions[0].astype(np.float64)
        seen = np.flatnonzero(self._visible(positions)[self._faces].all(axis=1))
        if not (fresh.any() and len(seen)):
            return
        points = observation.followed.positions[fresh]
        place, weights = closest_on_mesh(points, positions, self._faces[seen])
        face = seen[place]
        gaps = np.linalg.norm(interpolate(weights, positions[self._faces[face]]) - points, axis=1)
        for index in np.flatnonzero(gaps < NEAR_M).tolist():
            self.bound[int(numbers[fresh][index])] = int(face[index]), weights[index]
        followed = set(numbers.tolist())
        for number in list(self.bound)[:-_MOST_BOUND]:
            if number not in followed:
                del self.bound[number]
        logger.info("%d followed points, %d bound to the cloth", len(numbers), len(self.bound))

    def __call__(
        self, positions: Float[np.ndarray, "vertices 3"], observation: Observation
    ) -> Marks | None:
        """Return the targets of vertices at these positions [m]; None without feature tracks."""
        numbers, bound = observation.followed.numbers, self.bound
        known = np.array([number in bound for number in numbers.tolist()], dtype=bool)
        if not known.any():
            return None
        found = [bound[number] for number in numbers[known].tolist()]
        corners = self._faces[[face for face, _ in found]]
        weights = np.stack([weights for _, weights in found])
        miss = observation.followed.positions[known] - interpolate(weights, positions[corners])
        trust = 1.0 / (1.0 + (miss**2).sum(axis=1) / DOUBT_M**2) ** 2
        # A point moves the corners of its triangle by its offset, weighted barycentrically.
        share, count = (trust[:, None] * weights).ravel(), len(positions)
        pull = [np.bincount(corners.ravel(), share * np.repeat(axis, 3), count) for axis in miss.T]
        total = np.bincount(corners.ravel(), share, count)
        wanted = positions + np.stack(pull, axis=1) / np.maximum(total, 1e-12)[:, None]
        return Marks(wanted, total)


def no_anchors(state: State, observation: Observation) -> None:  # noqa: ARG001
    """Ignore the color, as the paper does."""
    return
