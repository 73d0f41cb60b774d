"""Checks of color against depth in the picture: mirrored, turned, shifted, or of another size.

Moving objects, and the rims of objects above the table, are at the same pixels in color and in
depth. Both are correlated over all shifts, for the color as it is and if it were mirrored, turned
or scaled. Nothing is doubted unless another placement fits clearly better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy import fft

from clothtrack.recordings.geometry_checks.change_maps import (
    change_maps,
    color_edges,
    height_edges,
    moving,
)
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures

_LARGEST_SHIFT = 2
"""Largest shift of the color that is accepted [reduced pixels, 1/160 of the width]. It is 0 on
right recordings, at most 1 on real ones."""

LEAST_FIT = 0.4
"""Sum of the two correlations that another placement must reach. Right ones reach 0.9 to 1.5,
a real T-shirt in front of clutter 0.65; wrong ones stay below 0.35."""

LEAST_GAIN = 0.2
"""Least gain of correlation over the recorded placement for another one to be accepted."""

FRAMES = 12
"""Number of frames that are correlated: those with the most motion."""

SCALES = (0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0)
"""Sizes of the color pictures of another stream, as multiples of the depth's: 1280 x 720 cut or
resized to 640 x 480, and 320 x 240 of the same."""

TURNS_DEG = (-20.0, -15.0, -10.0, -5.0, 5.0, 10.0, 15.0, 20.0)
"""Angles of the color against the depth that are tried; the best is refined to a degree."""

_LARGEST_TURN_DEG = 2.0
"""Smaller angles cannot be distinguished from none."""

_LEAST_TURN_GAIN = 0.12
"""The same gain for a turn. Right recordings gain 0.07 at most."""

_LEAST_SHIFT_GAIN = 0.05
"""The same gain for a shift on which motion and edges agree."""

_FLIPS = {
    "left to right": np.s_[:, :, ::-1],
    "upside down": np.s_[:, ::-1],
    "by half a turn": np.s_[:, ::-1, ::-1],
}

_Maps = Float[np.ndarray, "frames rows columns"]
_Pairs = tuple[tuple[_Maps, _Maps], ...]


@dataclass(frozen=True)
class Registration:
    """The registration of the color to the depth.

    Attributes:
        finding: how it would be placed clearly better; None if it is in place.
        fit: sum of the correlations of motion and edges, placed so.
    """

    finding: Finding | None
    fit: float


def registration(pictures: SmallPictures) -> Registration | None:
    """Return the registration of the color to the depth; None if too little moves to tell."""
    pairs = _maps(pictures)
    if pairs is None:
        return None
    as_recorded = _fit_in_place(pairs)
    turned = {
        name: _fit_in_place(_changed(pairs, lambda maps, steps=steps: maps[steps]))
        for name, steps in _FLIPS.items()
    }
    best = max(turned, key=lambda name: turned[name])
    if turned[best] >= max(LEAST_FIT, as_recorded + LEAST_GAIN):
        return _misplaced(
            "color_mirrored", turned[best], as_recorded, (turned[best], as_recorded + LEAST_GAIN),
            f"turned {best}",
        )  # fmt: skip
    right = Registration(None, as_recorded)
    shift, fit = _best_shift(pairs)
    if _length(shift) <= _LARGEST_SHIFT and fit >= 2 * LEAST_FIT:
        return right
    if similar := _similarity(pairs, fit, as_recorded):
        return similar
    edges_shift, _ = _best_shift(pairs[1:])
    agreed = np.abs(np.subtract(shift, edges_shift)).max() <= _LARGEST_SHIFT
    gained = fit >= max(LEAST_FIT, as_recorded + _LEAST_SHIFT_GAIN)
    if min(_length(shift), _length(edges_shift)) <= _LARGEST_SHIFT or not agreed or not gained:
        return right
    columns, rows = (pixels * pictures.factor for pixels in edges_shift)
    away, limit = float(np.hypot(columns, rows)), float(_LARGEST_SHIFT * pictures.factor)
    shown = f"moved by ({columns}, {rows}) pixels (at most {limit:.0f})"
    return _misplaced("color_shift", fit, as_recorded, (away, limit), shown, unit="px")


def _similarity(pairs: _Pairs, fit: float, as_recorded: float) -> Registration | None:
    """Return the scale or the turn that fits better than every shift, if one does."""
    scale, scaled = _best(pairs, SCALES, lambda factor: (0.0, factor))
    turn, turned_fit = _best(pairs, TURNS_DEG, lambda degrees: (degrees, 1.0))
    if scaled >= max(LEAST_FIT, fit + LEAST_GAIN, turned_fit):
        shown = f"{scale:.2f} times as large, as that of another stream or picture size"
        return _misplaced("color_scale", scaled, as_recorded, (scale, 1.0), shown)
    if turned_fit >= max(LEAST_FIT, fit + _LEAST_TURN_GAIN):
        near = [turn + by for by in (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)]
        turn, turned_fit = _best(pairs, near, lambda degrees: (degrees, 1.0))
        shown = f"turned by {turn:.0f} degrees (at most {_LARGEST_TURN_DEG:g})"
        limits = abs(turn), _LARGEST_TURN_DEG
        return _misplaced("color_turned", turned_fit, as_recorded, limits, shown, unit="deg")
    return None


def _misplaced(
    kind: str,
    fit: float,
    as_recorded: float,
    limits: tuple[float, float],
    shown: str,
    *,
    unit: str = "",
) -> Registration:
    text = (
        f"the color fits the depth when it is {shown} (correlation {fit:.2f} against "
        f"{as_recorded:.2f} as recorded): give color pictures that are registered to the depth, or "
        "leave color and masks out"
    )
    return Registration(Finding(kind, *limits, unit, "frames: color", text), fit)


def _maps(pictures: SmallPictures) -> _Pairs | None:
    """Return motion and edges of color and of height; None if too little moves."""
    if pictures.color is None or len(pictures.frames) < 3:
        return None
    changes = change_maps(pictures, step=2 if len(pictures.frames) > 4 else 1)
    assert changes.color is not None
    both = moving(changes.height_m) & moving(changes.color)
    if both.sum() < 2:
        return None
    strength = np.where(both, changes.height_m.sum(axis=(1, 2)), 0.0)
    chosen = np.sort(np.argsort(strength)[::-1][: min(FRAMES, int(both.sum()))])
    edges = (
        np.stack([color_edges(pictures.color[place]) for place in chosen]),
        np.stack([height_edges(pictures.height_m[place], pictures.filled_m) for place in chosen]),
    )
    motion = (changes.color[chosen], changes.height_m[chosen])
    if not all(maps.any() for maps in (*edges, *motion)):
        return None
    return motion, edges


def _changed(pairs: _Pairs, change: Callable[[_Maps], _Maps]) -> _Pairs:
    return tuple((change(color), height) for color, height in pairs)


def _fit_in_place(pairs: _Pairs) -> float:
    """Return the sum of the correlations without a shift."""
    total = 0.0
    for pair in pairs:
        color, height = (_centered(maps) for maps in pair)
        total += float((color * height).sum() / max(_scale(color, height), 1e-12))
    return total


def _best_shift(pairs: _Pairs) -> tuple[tuple[int, int], float]:
    """Return the best shift of the color, to the right and down [reduced pixels], and its fit."""
    fit = np.sum([_correlation(color, height) for color, height in pairs], axis=0)
    rows, columns = fit.shape
    row, column = np.unravel_index(int(fit.argmax()), fit.shape)
    return (int(columns // 2 - column), int(rows // 2 - row)), float(fit.max())


def _length(shift: tuple[int, int]) -> float:
    return float(np.hypot(*shift))


def _centered(maps: _Maps) -> _Maps:
    return maps - maps.mean(axis=(1, 2), keepdims=True)


def _scale(color: _Maps, height: _Maps) -> float:
    return float(np.sqrt((color**2).sum() * (height**2).sum()))


def _correlation(color: _Maps, height: _Maps) -> Float[np.ndarray, "shifts_down shifts_right"]:
    """Return the normalized cross-correlation over all frames; zero shift is in the middle."""
    color, height = _centered(color), _centered(height)
    size = [2 * side for side in color.shape[1:]]
    total = np.einsum("fyx,fyx->yx", fft.rfft2(color, size), fft.rfft2(height, size).conj())
    return fft.fftshift(fft.irfft2(total, size)) / max(_scale(color, height), 1e-12)


def _best(
    pairs: _Pairs, values: Sequence[float], how: Callable[[float], tuple[float, float]]
) -> tuple[float, float]:
    """Return the value whose angle [deg] and factor of the color fit best, and the fit."""
    fits = [_best_shift(_changed(pairs, lambda m, v=v: _similar(m, *how(v))))[1] for v in values]
    best = int(np.argmax(fits))
    return values[best], fits[best]


def _similar(maps: _Maps, degrees: float, factor: float) -> _Maps:
    rows, columns = maps.shape[1:]
    middle = ((columns - 1) / 2, (rows - 1) / 2)
    matrix = cv2.getRotationMatrix2D(middle, degrees, factor)
    return np.stack([cv2.warpAffine(each, matrix, (columns, rows)) for each in maps])
