"""Symmetries of a garment's outline, as permutations of its tokens under which it looks alike."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

_LABELINGS = 8
"""Maximum number of symmetries of a garment, that of a square."""

NEARLY_SQUARE = 0.85
"""Ratio of sides above which quarter turns are symmetries, because the sides of a crumpled cloth
look alike then."""

_ALIKE = 0.9
"""Intersection over union above which outlines look alike in a crumpled cloth."""

_SILHOUETTE_PIXELS = 96
"""Pixels along each side of the pictures in which outlines are compared."""


@dataclass(frozen=True, eq=False)
class Layered:
    """A flat mesh of one or two layers, with the side of each vertex (0 on seams) and face."""

    flat: Float[np.ndarray, "vertices 2"]
    faces: Int[np.ndarray, "faces 3"]
    side: Float[np.ndarray, " vertices"]
    of_face: Float[np.ndarray, " faces"]


def labelings(
    layered: Layered, places: Float[np.ndarray, "tokens 2"], sides: Float[np.ndarray, " tokens"]
) -> tuple[Int[np.ndarray, "labelings tokens"], Bool[np.ndarray, " labelings"]]:
    """Return token permutations under which the garment looks alike, such as a half turn.

    A single sheet looks alike from both sides. For a sewn garment, a mirror image of the outline
    shows the other layer. An outline symmetry is accepted if the transformed layer covers the layer
    that it becomes.
    """
    extent = np.ptp(layered.flat, axis=0)
    single = not layered.side.any()
    layers = [_filled(layered.flat, layered.faces[layered.of_face == k]) for k in (1.0, -1.0)]
    if single:
        layers = [_filled(layered.flat, layered.faces)] * 2
    signs = [(-1, -1), (1, -1), (-1, 1)]
    turns = [(False, one) for one in signs]
    if single and extent.min() > NEARLY_SQUARE * extent.max():
        turns += [(True, one) for one in [(1, 1), *signs]]
    unit = extent if single else np.ones(2)
    rows = [np.arange(len(places))]
    for swapped, sign in turns:
        over = not single and sign[0] * sign[1] < 0
        shape = (layers[0].T if swapped else layers[0])[:: sign[1], :: sign[0]]
        other = layers[1] if over else layers[0]
        if (shape & other).sum() < _ALIKE * (shape | other).sum():
            continue
        moved = (places / unit)[:, ::-1] if swapped else places / unit
        rows.append(named(moved * sign, -sides if over else sides, places / unit, sides))
    filled = rows + [rows[0]] * (_LABELINGS - len(rows))
    return np.array(filled), np.arange(_LABELINGS) < len(rows)


def mirrored(
    layered: Layered, places: Float[np.ndarray, "tokens 2"], sides: Float[np.ndarray, " tokens"]
) -> Int[np.ndarray, " tokens"]:
    """Return the token that each token becomes in the mirror image of the garment.

    A mirrored sheet is the same sheet seen from below. If its outline lacks the mirror symmetry,
    the tokens are unchanged.
    """
    if not layered.side.any():
        shape = _filled(layered.flat, layered.faces)
        if (shape & shape[:, ::-1]).sum() < _ALIKE * (shape | shape[:, ::-1]).sum():
            return np.arange(len(places))
    return named(places * (-1.0, 1.0), sides, places, sides)


def _filled(
    flat: Float[np.ndarray, "vertices 2"], faces: Int[np.ndarray, "faces 3"]
) -> Bool[np.ndarray, "rows columns"]:
    """Return the silhouette of a flat layer, with its extent stretched to a square of pixels."""
    unit = (flat - flat.min(axis=0)) / np.ptp(flat, axis=0)
    corners = np.rint(unit * (_SILHOUETTE_PIXELS - 1)).astype(np.int32)
    picture = np.zeros((_SILHOUETTE_PIXELS, _SILHOUETTE_PIXELS), np.uint8)
    for triangle in corners[faces]:
        cv2.fillConvexPoly(picture, triangle, 1)
    return picture.astype(bool)


def named(
    places: Float[np.ndarray, "asked 2"],
    sides: Float[np.ndarray, " asked"],
    tokens: Float[np.ndarray, "tokens 2"],
    token_sides: Float[np.ndarray, " tokens"],
) -> Int[np.ndarray, " asked"]:
    """Return the nearest token of the same layer."""
    far = 10.0 * float(np.ptp(tokens, axis=0).max())
    tree = cKDTree(np.column_stack([tokens, far * token_sides]))
    _, nearest = tree.query(np.column_stack([places, far * sides]))
    return nearest
