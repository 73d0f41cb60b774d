"""Measures of color against depth: the color is turned or shifted.

Moving objects, and the rims of objects above the table, are at the same pixels in color and in
depth. Both are correlated over all shifts, for the color as it is and if it were turned. Nothing is
doubted unless another placement fits clearly better.
"""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from jaxtyping import Float
from scipy import fft

from clothtrack.recordings.geometry_checks.finding import Measured, ObservedFrames
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures

_COLOR_CHANGE, _HEIGHT_CHANGE_M = (12.0, 40.0), (0.004, 0.02)
"""Change between frames up to which it is noise, and at which it is clipped: of a channel [of 255],
for flicker and shadows, and of the height [m], of which 2 mm of depth noise make 1 mm."""

_LEAST_MOVING = 0.002
"""Share of the picture that changes when something moves: a tenth of a hand."""

_LARGEST_SHIFT, _LARGEST_TURN_DEG = 2, 2.0
"""Largest shift of the color that is accepted [reduced pixels, 1/160 of the width], 0 on right
recordings and at most 1 on real ones; and angles that cannot be distinguished from none."""

_LEAST_FIT = 0.4
"""Sum of the two correlations that another placement must reach. Right ones reach 0.9 to 1.5,
a real T-shirt in front of clutter 0.65; wrong ones stay below 0.35."""

_LEAST_TURN_GAIN, _LEAST_SHIFT_GAIN = 0.12, 0.05
"""Least gain of correlation over the recorded placement for a turn to be accepted (right recordings
gain 0.07), and for a shift on which motion and edges agree."""

_FRAMES = 12
"""Number of frames that are correlated: those with the most motion."""

_TURNS_DEG = (-20.0, -15.0, -10.0, -5.0, 5.0, 10.0, 15.0, 20.0)
"""Angles of the color against the depth that are tried; the best is refined to a degree."""

_Maps = Float[np.ndarray, "frames rows columns"]
_Pairs = tuple[tuple[_Maps, _Maps], ...]


def turns(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the angle at which the color fits the depth clearly better [deg]."""
    yield from (placed for placed in frames.once(_placement) if "degrees" in placed)


def shifts(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the shift at which the color fits the depth clearly better [pixels]."""
    yield from (placed for placed in frames.once(_placement) if "degrees" not in placed)


def _placement(frames: ObservedFrames) -> list[Measured]:
    """Return where the color fits the depth clearly better; empty if it is in place."""
    pairs = _maps(frames.pictures)
    if pairs is None:
        return []
    shift, fit, as_recorded = _best_shift(pairs)
    if np.hypot(*shift) <= _LARGEST_SHIFT and fit >= 2 * _LEAST_FIT:
        return []
    told = {"fit": fit, "as_recorded": as_recorded}
    turn, turned_fit = _best_turn(pairs, _TURNS_DEG)
    if turned_fit >= max(_LEAST_FIT, fit + _LEAST_TURN_GAIN):
        turn, turned_fit = _best_turn(pairs, [turn + by for by in range(-3, 4)])
        turned = {"measured": abs(turn), "limit": _LARGEST_TURN_DEG, "degrees": turn}
        return [told | turned | {"fit": turned_fit}]
    of_edges, _, _ = _best_shift(pairs[1:])
    agreed = np.abs(np.subtract(shift, of_edges)).max() <= _LARGEST_SHIFT
    gained = fit >= max(_LEAST_FIT, as_recorded + _LEAST_SHIFT_GAIN)
    least = min(np.hypot(*shift), np.hypot(*of_edges))
    if least <= _LARGEST_SHIFT or not agreed or not gained:
        return []
    x, y = (pixels * frames.pictures.factor for pixels in of_edges)
    limit = float(_LARGEST_SHIFT * frames.pictures.factor)
    return [told | {"measured": float(np.hypot(x, y)), "limit": limit, "x": x, "y": y}]


def _maps(pictures: SmallPictures) -> _Pairs | None:
    """Return motion and edges of color and of height; None if too little moves."""
    color, heights = pictures.color, pictures.height_m
    if color is None or len(color) < 3:
        return None
    step = 2 if len(color) > 4 else 1
    apart = cv2.absdiff(color[step:].reshape(-1, 3), color[:-step].reshape(-1, 3))
    # Channel by channel, which is ten times as fast as along the last axis.
    apart = np.maximum(np.maximum(apart[:, 0], apart[:, 1]), apart[:, 2]).astype(np.float32)
    motion = _clipped(apart.reshape(color[step:].shape[:3]), *_COLOR_CHANGE)
    rise = np.nan_to_num(np.abs(heights[step:] - heights[:-step]), nan=0.0)
    rise = _clipped(rise, *_HEIGHT_CHANGE_M)
    both = _moving(motion) & _moving(rise)
    if both.sum() < 2:
        return None
    strength = np.where(both, rise.sum(axis=(1, 2)), 0.0)
    chosen = np.sort(np.argsort(strength)[::-1][: min(_FRAMES, int(both.sum()))])
    of_height, of_color = (edges[chosen] for edges in pictures.edges)
    pairs = (motion[chosen], rise[chosen]), (of_color, of_height)
    return pairs if all(maps.any() for pair in pairs for maps in pair) else None


def _clipped(change: _Maps, noise: float, most: float) -> _Maps:
    return np.clip(change - noise, 0.0, most)


def _moving(change: _Maps) -> np.ndarray:
    return (change > 0).mean(axis=(1, 2)) >= _LEAST_MOVING


def _best_shift(pairs: _Pairs) -> tuple[tuple[int, int], float, float]:
    """Return the best shift of the color, to the right and down [reduced pixels].

    Then follow the sums of the correlations at this shift and without one.
    """
    fit = np.sum([_correlation(color, height) for color, height in pairs], axis=0)
    rows, columns = (side // 2 for side in fit.shape)
    row, column = np.unravel_index(int(fit.argmax()), fit.shape)
    shift = int(columns - column), int(rows - row)
    return shift, float(fit.max()), float(fit[rows, columns])


def _correlation(color: _Maps, height: _Maps) -> Float[np.ndarray, "shifts_down shifts_right"]:
    """Return the normalized cross-correlation over all frames; zero shift is in the middle."""
    color, height = (maps - maps.mean(axis=(1, 2), keepdims=True) for maps in (color, height))
    scale = max(float(np.sqrt((color**2).sum() * (height**2).sum())), 1e-12)
    size = [2 * side for side in color.shape[1:]]
    total = np.einsum("fyx,fyx->yx", fft.rfft2(color, size), fft.rfft2(height, size).conj())
    return fft.fftshift(fft.irfft2(total, size)) / scale


def _best_turn(pairs: _Pairs, angles_deg: Sequence[float]) -> tuple[float, float]:
    """Return the angle of the color that fits best [deg], and the fit."""
    fits = [
        _best_shift(tuple((_turned(color, angle), height) for color, height in pairs))[1]
        for angle in angles_deg
    ]
    best = int(np.argmax(fits))
    return angles_deg[best], fits[best]


def _turned(maps: _Maps, degrees: float) -> _Maps:
    rows, columns = maps.shape[1:]
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), degrees, 1.0)
    return np.stack([cv2.warpAffine(each, matrix, (columns, rows)) for each in maps])
