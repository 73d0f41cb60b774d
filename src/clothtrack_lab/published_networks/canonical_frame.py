"""The unit cube in which every garment of a category has its canonical pose.

There is one cube per category, not per garment. A small shirt fills less of it than a large one, so
a canonical coordinate also encodes the size of the garment (GarmentNets, arXiv 2104.05177, 3.1).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError

_MARGIN_M = 0.1
"""Margin added to the longest edge of the category's box [m], as in the published models."""

_INFLATION = 0.12
"""Half the depth of a T-shirt's canonical pose over its width
(`garments.garment_meshes.tshirt`)."""


@dataclass(frozen=True)
class CanonicalFrame:
    """The map from canonical coordinates in meters to the unit cube, for one category.

    The origin maps to the middle of the cube.

    Attributes:
        scale: edges of the cube per meter [1/m].
        half_m: half extent along each axis of the largest garment of the category [m].
    """

    kind: str
    scale: float
    half_m: tuple[float, float, float]

    def to_unit(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Return canonical positions [m] as positions in the unit cube."""
        return points * self.scale + 0.5

    def to_meters(self, points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Return positions in the unit cube as canonical positions [m]."""
        return (points - 0.5) / self.scale


LARGEST_SIZE_M: dict[str, tuple[float, float]] = {"towel": (0.4, 0.4), "tshirt": (0.6, 0.55)}
"""Width and length [m] of the largest garment of each category that fits its cube."""

SHEETS = ("towel",)
"""Garments without an inside; their winding number changes sign when they are turned over."""

_LEAST_INFLATION = 0.05


def canonical_frame(kind: str) -> CanonicalFrame:
    """Return the unit cube of a category, with room for all its sizes and a margin."""
    _check_kind(kind)
    width, length = LARGEST_SIZE_M[kind]
    depth = _INFLATION * width if kind == "tshirt" else 0.0
    scale = 1.0 / (max(width, length) + _MARGIN_M)
    return CanonicalFrame(kind, scale, (width / 2.0, length / 2.0, depth))


def conventional(
    canonical: Float[np.ndarray, "vertices 3"], kind: str
) -> Float[np.ndarray, "vertices 3"]:
    """Return canonical coordinates [m] with a towel's longer side along x; others unchanged.

    Which side of a towel is its width is ambiguous. All inputs and targets of the networks follow
    this convention, so the sides decide a quarter turn if they differ. A towel that is nearly as
    wide as long stays ambiguous by a quarter turn. The networks then have to guess, and errors up
    to `symmetries` contain wrong guesses.
    """
    extent = np.ptp(canonical, axis=0)
    if kind not in SHEETS or extent[0] >= extent[1]:
        return canonical
    # Rotate about z instead of swapping x and y, so that faces keep facing up.
    return np.column_stack([canonical[:, 1], -canonical[:, 0], canonical[:, 2]])


def check_canonical(canonical: Float[np.ndarray, "vertices 3"], kind: str) -> None:
    """Refuse a canonical pose [m] that is ambiguous or too large for its category's cube."""
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
