"""Checks of the masks against the color: wrong size, a hand or second object, cut off."""

import cv2
import numpy as np
from jaxtyping import Bool

from clothtrack.recordings.colors import CORE, NO, learned_set, named_set, votes_of
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import WIDEST_SHARE, main_components

FRAMES = 8
"""Number of frames whose masks are compared with the color, spread over all."""

_LEAST_TOLD_APART = 0.8
"""Share of the pixels deep in the mask that must have colors of the cloth, and share of those far
away that must not, for colors to be informative."""

_MOST_RIM_CLOTH = 0.5
"""Share of the rim outside of the masks, two reduced pixels wide (1/80 of the picture), that may
have the cloth's colors. On right recordings it is below 0.2: shadows and mixed pixels."""

_MOST_RIM_OTHER = 0.5
"""The same for the rim inside the masks and colors that are not the cloth's."""

_NEW_COLOR = 14.0
"""Least difference in a and b of CIE Lab from all colors of the first frame's cloth for a color to
be new: skin and a red cloth differ by 20."""

_HAND_HEIGHT_M = 0.015
"""Height above the table [m] from which a part of such colors is a hand, and not the table."""

_MOST_FOREIGN = 0.04
"""Largest share of a mask with colors that the cloth did not have and that go on outside of it: a
fingertip has 1 %, a hand 5 to 20."""

_LEAST_FOREIGN_FRAMES = 3
"""Least number of frames in which such colors count."""

_SECOND_PART = 0.15
"""Size of a second part of the first mask, as a share of the first, that is another object."""

_PART_GAP = 3
"""Least distance of such a part from the first [reduced pixels]."""

_RIM_CONTACT = 5
"""Pixels of the rim of the reduced picture that the cloth may touch: 1/30 of its width. A real
hanging cloth whose corner is cut off by a few pixels has 4."""


def mask_findings(recording: Recording, pictures: SmallPictures) -> list[Finding]:
    """Return what is wrong with the masks of the cloth."""
    cloth = _cloth(recording, pictures)
    if cloth is None or not cloth[0].any():
        return []
    foreign = np.zeros_like(cloth)
    found = []
    if pictures.mask is not None and pictures.color is not None:
        foreign = _foreign(pictures, cloth) if recording.table is not None else foreign
        found = _hand(pictures, cloth, foreign) or _rim(pictures, cloth)
    return [*found, *_second_part(cloth[0]), *_out_of_picture(pictures, cloth & ~foreign)]


def _cloth(
    recording: Recording, pictures: SmallPictures
) -> Bool[np.ndarray, "frames rows columns"] | None:
    """Return the cloth by its masks, or by its named color; None if neither shows it."""
    if pictures.mask is not None:
        return np.stack([main_components(each > 0.5) for each in pictures.mask])
    if recording.cloth.color is None or pictures.color is None:
        return None
    members = named_set(recording.cloth.color)
    kernel = np.ones((3, 3), np.uint8)
    marks = [(votes_of(each, members) == CORE).astype(np.uint8) for each in pictures.color]
    opened = [cv2.morphologyEx(each, cv2.MORPH_OPEN, kernel).view(bool) for each in marks]
    found = np.stack([main_components(each) for each in opened])
    # If the table has the color, too, the color is not informative.
    return None if found[0].mean() > WIDEST_SHARE else found


def _rim(pictures: SmallPictures, cloth: Bool[np.ndarray, "frames rows columns"]) -> list[Finding]:
    """Return a finding if colors of the cloth go on outside its masks, or others begin inside."""
    chosen = np.unique(np.linspace(0, len(cloth) - 1, FRAMES).round().astype(int))
    assert pictures.color is not None
    color = np.concatenate(list(pictures.color[chosen]))
    masks = [np.pad(cloth[place], 8) for place in chosen]

    def ring(inner: int, outer: int) -> Bool[np.ndarray, "rows columns"]:
        """Return pixels whose distance outside of the masks is in between; negative is inside."""
        rings = []
        for mask in masks:
            out = cv2.distanceTransform((~mask).view(np.uint8), cv2.DIST_L2, 5)
            into = cv2.distanceTransform(mask.view(np.uint8), cv2.DIST_L2, 5)
            away = np.where(mask, 1.0 - into, out)
            rings.append(((away > inner) & (away <= outer))[8:-8, 8:-8])
        return np.concatenate(rings)

    inside, outside = ring(-99, -5), ring(8, 999)
    if inside.sum() < 200 or outside.sum() < 200:
        return []
    votes = votes_of(color, learned_set(color, inside, outside))
    if (votes[inside] == CORE).mean() < _LEAST_TOLD_APART:
        return []
    if (votes[outside] == CORE).mean() > 1 - _LEAST_TOLD_APART:
        return []
    around, within = ring(1, 3), ring(-3, -1)
    too_small = float((votes[around] == CORE).mean()) if around.any() else 0.0
    too_large = float((votes[within] == NO).mean()) if within.any() else 0.0
    if too_small > _MOST_RIM_CLOTH:
        kind, share, limit = "mask_small", too_small, _MOST_RIM_CLOTH
        shown = "of the rim outside of the masks has the colors of the cloth inside"
    elif too_large > _MOST_RIM_OTHER:
        kind, share, limit = "mask_large", too_large, _MOST_RIM_OTHER
        shown = "of the rim inside the masks has colors that the cloth does not have"
    else:
        return []
    return [
        Finding(
            kind, share, limit, "", "frames: mask",
            f"{100 * share:.0f} % {shown}, {3 * pictures.factor} pixels wide (at most "
            f"{100 * limit:.0f} %): make the masks reach the rim of the cloth; clothtrack segment "
            "makes them",
        )
    ]  # fmt: skip


def _foreign(
    pictures: SmallPictures, cloth: Bool[np.ndarray, "frames rows columns"]
) -> Bool[np.ndarray, "frames rows columns"]:
    """Return raised parts of the masks with colors that the cloth did not have at first.

    They count as a hand if they go on outside of the mask in the same color, or to the rim of the
    picture; the other side of a cloth does not.
    """
    parts = np.zeros_like(cloth)
    assert pictures.color is not None
    planes = np.stack([cv2.cvtColor(each, cv2.COLOR_RGB2LAB)[..., 1:] for each in pictures.color])
    counts = np.zeros((256, 256), np.int32)
    np.add.at(counts, tuple(planes[0][cloth[0]].T), 1)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * int(_NEW_COLOR) + 1,) * 2)
    known = cv2.dilate((counts >= 3).astype(np.uint8), reach)
    new = known[planes[..., 0], planes[..., 1]] == 0
    new &= np.nan_to_num(pictures.height_m, nan=1.0) > _HAND_HEIGHT_M
    for place, (mark, mask) in enumerate(zip(new, cloth, strict=True)):
        opened = cv2.morphologyEx(mark.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        count, labels = cv2.connectedComponents(opened)
        for part in range(1, count):
            inside, outside = (labels == part) & mask, (labels == part) & ~mask
            rim = inside[0].any() or inside[-1].any() or inside[:, [0, -1]].any()
            goes_on = outside.sum() > 0.2 * inside.sum() and inside.any()
            if rim or (goes_on and _same_color(planes[place], inside, outside)):
                parts[place] |= inside
    return parts


def _same_color(
    planes: np.ndarray,
    inside: Bool[np.ndarray, "rows columns"],
    outside: Bool[np.ndarray, "rows columns"],
) -> bool:
    middle = [np.median(planes[each], axis=0) for each in (inside, outside)]
    return bool(np.abs(middle[0] - middle[1]).max() < _NEW_COLOR)


def _hand(
    pictures: SmallPictures,
    cloth: Bool[np.ndarray, "frames rows columns"],
    foreign: Bool[np.ndarray, "frames rows columns"],
) -> list[Finding]:
    shares = foreign.sum(axis=(1, 2)) / np.maximum(cloth.sum(axis=(1, 2)), 1)
    wrong = np.flatnonzero(shares > _MOST_FOREIGN)
    if len(wrong) < _LEAST_FOREIGN_FRAMES:
        return []
    share = float(np.median(shares[wrong]))
    return [
        Finding(
            "mask_with_hand", share, _MOST_FOREIGN, "", "frames: mask",
            f"{100 * share:.0f} % of the mask of {len(wrong)} frames (at most "
            f"{100 * _MOST_FOREIGN:.0f} %; frame {pictures.frames[int(wrong[0])]} first) has "
            "colors that the cloth did not have in the first and that go on outside of it, as a "
            "hand or tool has: leave these out of the masks",
        )
    ]  # fmt: skip


def _second_part(mask: Bool[np.ndarray, "rows columns"]) -> list[Finding]:
    """Return a finding if the first mask, before any tool divides the cloth, has two parts."""
    _, labels = cv2.connectedComponents(mask.view(np.uint8))
    areas = np.bincount(labels.ravel())[1:]
    if len(areas) < 2:
        return []
    first, second = np.argsort(areas)[::-1][:2] + 1
    share = float(areas[second - 1] / areas[first - 1])
    away = cv2.distanceTransform((labels != first).astype(np.uint8), cv2.DIST_L2, 3)
    if share < _SECOND_PART or away[labels == second].min() < _PART_GAP:
        return []
    return [
        Finding(
            "mask_two_parts", share, _SECOND_PART, "", "frames[0]: mask",
            f"the cloth of the first frame has a second part, {100 * share:.0f} % as large as the "
            f"first (at most {100 * _SECOND_PART:.0f} %): leave other things out of the masks, or "
            "take them off the table",
        )
    ]  # fmt: skip


def _out_of_picture(
    pictures: SmallPictures, cloth: Bool[np.ndarray, "frames rows columns"]
) -> list[Finding]:
    sides = (cloth[:, 0], cloth[:, -1], cloth[:, 1:-1, 0], cloth[:, 1:-1, -1])
    rims = np.sum([side.sum(axis=1) for side in sides], axis=0)
    worst = int(np.argmax(rims))
    if rims[worst] <= _RIM_CONTACT:
        return []
    pixels, limit = float(rims[worst] * pictures.factor), float(_RIM_CONTACT * pictures.factor)
    return [
        Finding(
            "cloth_leaves_picture", pixels, limit, "px", "cameras",
            f"the cloth reaches the rim of the picture in {int((rims > _RIM_CONTACT).sum())} "
            f"frames, over {pixels:.0f} pixels in frame {pictures.frames[worst]} (at most "
            f"{limit:.0f}), and tracking needs all of it in the picture: move the camera or the "
            "cloth",
        )
    ]  # fmt: skip
