"""The unit cube in which every garment of a category has its canonical pose.

One cube per category, not per garment: a small shirt fills less of it than a large one, so that
a canonical coordinate also says how large the garment is (GarmentNets, arXiv 2104.05177, 3.1).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError

_MARGIN_M = 0.1
"""Added to the longest edge of the category's box [m], as the published models do."""

_INFLATION = 0.12
"""Half depth of a T-shirt's canonical pose over its width (`garments.garment_meshes.tshirt`)."""


@dataclass(frozen=True)
class CanonicalFrame:
    """How canonical coordinates in meters map to the unit cube, for one category.

    The origin becomes the middle of the cube.

    Attributes:
        kind: the category.
        scale: edges of the cube per meter [1/m].
        half_m: half extent along each axis of the largest garment of the category [m].
    """

    kind: str
    scale: float
    half_m: tuple[float, float, float]

    def to_unit(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Canonical positions [m] in the unit cube."""
        return points * self.scale + 0.5

    def to_meters(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Positions in the unit cube as canonical positions [m]."""
        return (points - 0.5) / self.scale


LARGEST_SIZE_M: dict[str, tuple[float, float]] = {"towel": (0.4, 0.4), "tshirt": (0.6, 0.55)}
"""Width and length [m] of the largest garment of each category that its cube has room for."""

SHEETS = ("towel",)
"""Garments without an inside: turned over, their winding number has the other sign."""

_LEAST_INFLATION = 0.05


def canonical_frame(kind: str) -> CanonicalFrame:
    """The unit cube of a category: all sizes of its garments, and a margin.

    Args:
        kind: "towel" or "tshirt".

    Raises:
        InvalidConfigError: for a category without a canonical pose.
    """
    _check_kind(kind)
    width, length = LARGEST_SIZE_M[kind]
    depth = _INFLATION * width if kind == "tshirt" else 0.0
    scale = 1.0 / (max(width, length) + _MARGIN_M)
    return CanonicalFrame(kind, scale, (width / 2.0, length / 2.0, depth))


def conventional(
    canonical: Float[np.ndarray, "vertices 3"], kind: str
) -> Float[np.ndarray, "vertices 3"]:
    """Canonical coordinates [m] with the longer side of a towel along x; others as they are.

    Nobody can say which side of a towel is its width. All that the networks learn from and are
    asked about goes through this convention, so that a quarter turn is decided by the sides where
    they differ. A towel that is nearly as wide as long stays ambiguous by a quarter turn: the
    networks have to guess there, and errors up to `symmetries` contain wrong guesses.

    Args:
        canonical: of all vertices of a garment, about the origin.
        kind: "towel" or "tshirt".
    """
    extent = np.ptp(canonical, axis=0)
    if kind not in SHEETS or extent[0] >= extent[1]:
        return canonical
    # A turn about z, not an exchange of x and y: faces keep looking up.
    return np.column_stack([canonical[:, 1], -canonical[:, 0], canonical[:, 2]])


def check_canonical(canonical: Float[np.ndarray, "vertices 3"], kind: str) -> None:
    """Refuse a canonical pose [m] that the cube of its category cannot tell apart or hold.

    Raises:
        InvalidConfigError: it reaches out of the cube, the layers of a garment lie in one another,
            or the category has no cube.
    """
    reach = float(np.abs(canonical_frame(kind).to_unit(canonical) - 0.5).max())
    if not reach <= 0.5:
        half_m = 0.5 / canonical_frame(kind).scale
        raise InvalidConfigError(
            f"the canonical pose of the {kind} reaches {reach / 0.5 * half_m:.2f} m from the "
            f"origin, its cube {half_m:.2f} m; give canonical coordinates in meters about the "
            "origin, or a smaller garment"
        )
    extent = np.ptp(canonical, axis=0)
    if kind not in SHEETS and extent[2] < _LEAST_INFLATION * extent[0]:
        raise InvalidConfigError(
            f"the layers of the {kind}'s canonical pose are {1e3 * extent[2]:.0f} mm apart, so "
            "that front and back are one place; inflate it as garments.garment_meshes.tshirt does"
        )


def _check_kind(kind: str) -> None:
    if kind not in LARGEST_SIZE_M:
        raise InvalidConfigError(
            f"kind is {kind!r}; categories with a canonical pose are {', '.join(LARGEST_SIZE_M)}"
        )
