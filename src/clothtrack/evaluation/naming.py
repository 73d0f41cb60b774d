"""Correspondence between tracked vertices and the true cloth, up to the symmetries of a towel.

An unmarked towel has four symmetries, a square one eight, and no camera distinguishes them. A
template has the same correspondence as the truth. A mesh fitted without one takes its canonical
coordinates from its pose in the world; they may differ from the truth's by a symmetry without
being wrong.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from clothtrack.evaluation.truth import Truth, material_map, material_points
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

NEARLY_SQUARE = 0.1
"""Relative difference of the sides below which the longer side is ambiguous."""

FLAT = 1e-6
"""Height of the canonical pose [m] up to which the garment has one layer."""

Where = tuple[Int[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]]
"""True face of each vertex, and barycentric coordinates in it."""


def true_places(tracked: TrackedTrajectory, truth: Truth) -> Where | None:
    """Return the place of each tracked vertex on the true mesh; None without canonical coordinates.

    The tracked canonical coordinates are used unchanged if they come from the recording's template,
    or if the garment has two layers, whose front is known. Otherwise the symmetry that is nearest
    to the truth at the first common frame is applied to all frames.
    """
    if truth.canonical is None or tracked.mesh.canonical is None:
        return None
    canonical = np.asarray(tracked.mesh.canonical, np.float64)
    own = material_map(truth.canonical, truth.faces, canonical)
    source = dict(tracked.provenance.get("initial_state") or {}).get("source", "template")
    common = [frame for frame in tracked.frames.tolist() if truth.at(frame) is not None]
    if source == "template" or np.ptp(canonical[:, 2]) > FLAT or not common:
        return own
    found = np.asarray(tracked.positions[tracked.frames.tolist().index(common[0])], np.float64)
    surface = truth.at(common[0])
    assert surface is not None  # such frames were chosen
    namings = [own] + [
        material_map(truth.canonical, truth.faces, named)
        for named in _look_alikes(canonical, truth.canonical)
    ]
    gaps = [_gap_m(found, surface, truth, where) for where in namings]
    return namings[int(np.argmin(gaps))]


def _gap_m(
    found: Float[np.ndarray, "vertices 3"],
    surface: Float[np.ndarray, "true_vertices 3"],
    truth: Truth,
    where: Where,
) -> float:
    points = material_points(surface, truth.faces, where)
    return float(np.linalg.norm(found - points, axis=1).mean())


def _look_alikes(
    canonical: Float[np.ndarray, "vertices 3"], true_canonical: Float[np.ndarray, "true_vertices 3"]
) -> Sequence[Float[np.ndarray, "vertices 3"]]:
    """Return the flat coordinates under all symmetries, centered on the true ones."""
    flat = canonical - _middle(canonical)
    turned = flat[:, [1, 0, 2]]
    own, true = (np.ptp(one, axis=0)[:2] for one in (canonical, true_canonical))
    square = abs(own[0] - own[1]) < NEARLY_SQUARE * own.max()
    along = (own[0] > own[1]) == (true[0] > true[1])
    kept = [flat, turned] if square else [flat if along else turned]
    signs = [(a, b, 1.0) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    return [one * np.array(sign) + _middle(true_canonical) for one in kept for sign in signs]


def _middle(canonical: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, " 3"]:
    return 0.5 * (canonical.min(axis=0) + canonical.max(axis=0))
