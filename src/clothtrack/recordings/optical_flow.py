"""Motion of small windows between two pictures, under changing light and at any speed.

Windows are followed by B. Lucas and T. Kanade's method ("An iterative image registration technique
with an application to stereo vision", IJCAI 1981; OpenCV's), from a guess, and back again. A window
that returns to its start counts as found (Z. Kalal, K. Mikolajczyk, J. Matas, "Forward-backward
error: automatic detection of tracking failures", doi:10.1109/ICPR.2010.675). Smaller pictures,
which are usual for fast motion, are not searched first, because in them a weave vanishes or is
mistaken for the weave beside it.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.spatial import cKDTree

WINDOW_PX = 15
"""Side of the window that is compared [pixels]."""

_HOME_PX = 0.25
"""A point that ends farther from its start than this [pixels] when followed back is not found."""

SMOOTH_PX = 1.5
"""Standard deviation by which a picture is smoothed first [pixels], because noise of single pixels
makes windows of the same cloth differ."""

_EVEN_SCALE = 40.0
"""Gray values of one standard deviation in an even picture."""

_MOST_DIFFERENT = 15.0
"""Largest mean difference of matching windows [gray values]. Unrelated windows of even pictures
differ by 45."""

_LEAST_DEVIATION = 1.0
"""Added to the standard deviation [gray values], so that noise of plain cloth stays small."""

_NEAR_PX = 60.0
"""Largest distance [pixels] of a found point that predicts the motion of another."""

_TOLD_BY = 8
"""Number of found points that predict the motion of one beside them."""

_AROUND_PX = WINDOW_PX + 16
"""Margin around the windows to which pictures are cut [pixels]: nothing is followed farther from
its guess than a window is wide, and slopes of the whole picture cost more than the search."""

ROUNDS = 4
"""Most rounds in which missing points are searched where their neighbors have moved."""


def even_picture(
    gray: UInt8[np.ndarray, "height width"], cloth: Bool[np.ndarray, "height width"]
) -> UInt8[np.ndarray, "height width"]:
    """Return the brightness of the cloth, normalized by its mean and deviation in a window.

    Lifted cloth turns dark or bright, but the pattern of its print or weave is kept.
    """
    even = np.full(gray.shape, 128, np.uint8)
    rows, columns = np.flatnonzero(cloth.any(axis=1)), np.flatnonzero(cloth.any(axis=0))
    if not len(rows):
        return even
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    window = (WINDOW_PX, WINDOW_PX)
    of_cloth = cloth[part].astype(np.float32)
    share = np.maximum(cv2.blur(of_cloth, window), 1e-3)
    bright = cv2.GaussianBlur(gray[part].astype(np.float32), (0, 0), SMOOTH_PX)
    difference = (bright - cv2.blur(bright * of_cloth, window) / share) * of_cloth
    square = cv2.blur(difference * difference, window) / share
    deviation = np.sqrt(np.maximum(square, 0.0)) + _LEAST_DEVIATION
    even[part] = np.clip(128.0 + _EVEN_SCALE * difference / deviation, 0.0, 255.0)
    return even


def carried(
    before: UInt8[np.ndarray, "height width"],
    after: UInt8[np.ndarray, "height width"],
    pixels: Float32[np.ndarray, "points 2"],
    steps: Float32[np.ndarray, "points 2"],
) -> tuple[Float32[np.ndarray, "points 2"], Bool[np.ndarray, " points"]]:
    """Return where windows of one even picture are in the next, and which were found.

    Args:
        steps: last motion of each window [pixels]: it is searched as far again, and then where its
            neighbors that were found have moved.
    """
    there, found = matched(before, after, pixels, steps)
    for _ in range(ROUNDS):
        lost = np.flatnonzero(~found)
        moves, near = moved_with(pixels[lost], pixels[found], (there - pixels)[found])
        lost, moves = lost[near], moves[near]
        there[lost], found[lost] = matched(before, after, pixels[lost], moves)
        if not found[lost].any():
            break
    return there, found


def matched(
    before: UInt8[np.ndarray, "height width"],
    after: UInt8[np.ndarray, "height width"],
    pixels: Float32[np.ndarray, "points 2"],
    guess: Float32[np.ndarray, "points 2"],
) -> tuple[Float32[np.ndarray, "points 2"], Bool[np.ndarray, " points"]]:
    """Return where windows of one even picture are in another, near a guess of their motion."""
    if not len(pixels):
        return pixels.copy(), np.zeros(0, dtype=bool)
    there, found = _lucas_kanade(before, after, pixels, pixels + guess)
    home, also = _lucas_kanade(after, before, there, there - guess)
    return there, found & also & (np.linalg.norm(home - pixels, axis=1) < _HOME_PX)


def moved_with(
    pixels: Float32[np.ndarray, "points 2"],
    others: Float32[np.ndarray, "others 2"],
    moves: Float32[np.ndarray, "others 2"],
) -> tuple[Float32[np.ndarray, "points 2"], Bool[np.ndarray, " points"]]:
    """Return the motion of the others beside each point [pixels], and which had one beside."""
    if not len(pixels) or not len(others):
        return np.zeros_like(pixels), np.zeros(len(pixels), dtype=bool)
    told_by = min(_TOLD_BY, len(others))
    distance, place = cKDTree(others).query(pixels, k=np.arange(1, told_by + 1))
    # The median; `np.median` takes longer than the search for so few.
    told = np.sort(moves[place], axis=1)
    middle = 0.5 * (told[:, (told_by - 1) // 2] + told[:, told_by // 2])
    return middle, distance[:, 0] < _NEAR_PX


def _lucas_kanade(
    before: UInt8[np.ndarray, "height width"],
    after: UInt8[np.ndarray, "height width"],
    pixels: Float32[np.ndarray, "points 2"],
    guess: Float32[np.ndarray, "points 2"],
) -> tuple[Float32[np.ndarray, "points 2"], Bool[np.ndarray, " points"]]:
    height, width = before.shape
    # Points outside the picture are not found anyway, and an empty part would be an error.
    ends = np.clip(np.concatenate([pixels, guess]), 0.0, (width - 1.0, height - 1.0))
    low = np.clip(np.floor(ends.min(axis=0)).astype(int) - _AROUND_PX, 0, None)
    high = np.ceil(ends.max(axis=0)).astype(int) + _AROUND_PX + 1
    part, corner = np.s_[low[1] : high[1], low[0] : high[0]], low.astype(np.float32)
    there, found, different = cv2.calcOpticalFlowPyrLK(
        before[part], after[part], (pixels - corner)[:, None], (guess - corner)[:, None].copy(),
        winSize=(WINDOW_PX, WINDOW_PX), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return there[:, 0] + corner, (found[:, 0] == 1) & (different[:, 0] < _MOST_DIFFERENT)
