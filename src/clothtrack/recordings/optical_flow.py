"""Where small windows of one picture are in another, whatever the light does and however fast.

Windows are followed by B. Lucas and T. Kanade's method ("An iterative image registration technique
with an application to stereo vision", IJCAI 1981; OpenCV's), from a guess, and back again: what
comes home is found (Z. Kalal, K. Mikolajczyk, J. Matas, "Forward-backward error: automatic
detection of tracking failures", doi:10.1109/ICPR.2010.675). No smaller pictures are searched first,
as is usual for fast motion: in those a weave vanishes, or is taken for the weave beside it.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from scipy.spatial import cKDTree

WINDOW_PX = 15
"""Side of the window that is compared [pixels]."""

_HOME_PX = 0.25
"""A point that ends farther from home than this [pixels] when it is followed back is not found."""

SMOOTH_PX = 1.5
"""Standard deviation by which a picture is smoothed first [pixels]: noise of single pixels makes
windows of the same cloth different."""

_EVEN_SCALE = 40.0
"""Gray values of one standard deviation in an even picture."""

_MOST_DIFFERENT = 15.0
"""Gray values by which a window may differ on average from that which it is taken for. Windows of
even pictures that have nothing to do with each other differ by 45."""

_LEAST_DEVIATION = 1.0
"""Added to the standard deviation [gray values], so that noise of plain cloth stays small."""

_NEAR_PX = 60.0
"""How far away [pixels] a point may be that says where another has gone."""

_TOLD_BY = 8
"""So many points that were found say where one beside them has gone."""

_AROUND_PX = WINDOW_PX + 16
"""Around the windows pictures are cut so far away [pixels]: nothing is followed farther from its
guess than a window is wide, and slopes of the whole picture cost more than the search."""

ROUNDS = 4
"""Most times that points which were not found are looked for where those beside them have gone."""


def even_picture(
    gray: UInt8[np.ndarray, "height width"], cloth: Bool[np.ndarray, "height width"]
) -> UInt8[np.ndarray, "height width"]:
    """Brightness less its mean, over its standard deviation, of the cloth in a window around.

    Cloth that is lifted turns dark or bright; what is printed on it, or woven, keeps its pattern.

    Args:
        gray: brightness.
        cloth: which pixels are cloth; the others become even gray.
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
        before: the one.
        after: the next.
        pixels: the middles of the windows in it.
        steps: how far each went the last time [pixels]: it is looked for as far again, and then
            where those that are found beside it have gone.
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
    """Where windows of one even picture are in another, near a guess of how far they went."""
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
    """How far others went that were beside each point [pixels], and which had one beside it."""
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
    # What lies outside is not found there either; a part that is empty would be an error.
    ends = np.clip(np.concatenate([pixels, guess]), 0.0, (width - 1.0, height - 1.0))
    low = np.clip(np.floor(ends.min(axis=0)).astype(int) - _AROUND_PX, 0, None)
    high = np.ceil(ends.max(axis=0)).astype(int) + _AROUND_PX + 1
    part, corner = np.s_[low[1] : high[1], low[0] : high[0]], low.astype(np.float32)
    there, found, different = cv2.calcOpticalFlowPyrLK(
        before[part], after[part], (pixels - corner)[:, None], (guess - corner)[:, None].copy(),
        winSize=(WINDOW_PX, WINDOW_PX), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return there[:, 0] + corner, (found[:, 0] == 1) & (different[:, 0] < _MOST_DIFFERENT)
