"""Check for a camera pushed while recording: the table in its depth moves, or the picture does."""

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.recordings.geometry_checks.change_maps import color_edges, height_edges
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.recording import Recording

_LARGEST_MOTION_M = 0.0025
"""Change of the table's height somewhere in the picture [m] up to which the camera stands still.
It is below 0.4 mm on right recordings; a camera turned by 1 degree makes 7."""

_EVERY = 2
"""Stride along each axis of the reduced pixels that the table is fitted to; thousands suffice."""

_NEAR_TABLE_M = 0.03
"""Pixels of the first frames this near to the recorded table [m] may be the table."""

_MOST_CHANGE_M = 0.08
"""A pixel whose height changes by more [m] shows a hand."""

_INLIER_M = 0.005
_FEWEST_INLIERS = 0.6
"""Share of the table's pixels that must agree within so much [m] on how the table moved."""

_ROUNDS = 5
"""Rounds of the reweighted fit, after which it is steady."""

_LEAST_JUMP, _MOST_JUMP = 2.5, 15.0
"""Limits of the shift of the whole picture between two frames [reduced pixels, 1/160 of the width]
that is a push. A hand that moves fast looks like a larger shift."""

_LEAST_FIT, _LEAST_GAIN = 0.58, 0.15
"""Correlation of the edges that the shift must reach, and by how much it must be better than none.
"""

_FEWEST_FRAMES = 4
"""Fewer frames are not enough for the check."""

_Motion = tuple[float, float, str]
"""The measured value, its limit, and the unit of both."""


def camera_motion_findings(recording: Recording, pictures: SmallPictures) -> list[Finding]:
    """Return from which frame on the camera is elsewhere; nothing if it stands still."""
    if len(pictures.frames) < _FEWEST_FRAMES:
        return []
    return _table_moved(recording, pictures) or _picture_jumped(recording, pictures)


def _table_moved(recording: Recording, pictures: SmallPictures) -> list[Finding]:
    """Return a finding if the table is turned or shifted; only cloth and hands may move."""
    if recording.table is None:
        return []
    heights = pictures.height_m[:, ::_EVERY, ::_EVERY]
    known = np.isfinite(heights[:3])
    first = np.where(known, heights[:3], 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    table = known.any(axis=0) & (np.abs(first) < _NEAR_TABLE_M)
    if pictures.mask is not None:
        table &= (pictures.mask[:, ::_EVERY, ::_EVERY] == 0).all(axis=0)
    moved = np.array([_table_motion_m(height - first, table) for height in heights])
    lasting = np.minimum(moved[:-1], moved[1:])  # A change in a single frame is noise, or an arm.
    most_m = float(lasting.max())
    if most_m <= _LARGEST_MOTION_M:
        return []
    since = pictures.frames[int(np.argmax(lasting > _LARGEST_MOTION_M))]
    shown = f"the table in its depth lies up to {1e3 * most_m:.0f} mm from where it was at first"
    return [_finding(pictures, since, (most_m, _LARGEST_MOTION_M, "m"), shown)]


def _table_motion_m(
    change: Float[np.ndarray, "rows columns"], table: Bool[np.ndarray, "rows columns"]
) -> float:
    """Return the largest change of the table's height in the picture [m]; 0 if not known."""
    usable = table & (np.abs(np.nan_to_num(change, nan=np.inf)) < _MOST_CHANGE_M)
    rows, columns = np.nonzero(usable)
    if len(rows) < 0.1 * change.size:
        return 0.0
    across = 2.0 * columns / (change.shape[1] - 1) - 1.0
    down = 2.0 * rows / (change.shape[0] - 1) - 1.0
    basis, wanted = np.stack([np.ones(len(rows)), across, down]), change[usable].astype(np.float64)
    plane, away = np.zeros(3), wanted - np.median(wanted)
    for _ in range(_ROUNDS):
        weighted = basis / np.square(1.0 + (away / _INLIER_M) ** 2)
        plane = np.linalg.solve(weighted @ basis.T, weighted @ wanted)
        away = wanted - plane @ basis
    if (np.abs(away) < _INLIER_M).mean() < _FEWEST_INLIERS:
        return 0.0
    return float(np.abs(plane).sum())


def _picture_jumped(recording: Recording, pictures: SmallPictures) -> list[Finding]:
    """Return a finding if all edges jump between two frames, and hardly move before and after."""
    as_recorded, fit, away = _step_shifts(pictures)
    # Constant motion also looks like a jump after a missing frame, so speeds are compared.
    took = np.diff([recording.frames[frame].time_s for frame in pictures.frames])
    speed = away / np.maximum(took, 1e-9)
    beside = took * np.maximum(np.append(speed[1:], 0.0), np.append(0.0, speed[:-1]))
    jump = (away >= _LEAST_JUMP) & (away <= _MOST_JUMP) & (beside <= 0.5 * away)
    jump &= (fit >= _LEAST_FIT) & (fit >= as_recorded + _LEAST_GAIN)
    if not jump.any():
        return []
    step = int(np.argmax(np.where(jump, fit - as_recorded, -1.0)))
    pixels, limit = float(away[step] * pictures.factor), _LEAST_JUMP * pictures.factor
    shown = f"the whole picture jumps by {pixels:.0f} pixels there"
    return [_finding(pictures, pictures.frames[step + 1], (pixels, limit, "px"), shown)]


def _step_shifts(
    pictures: SmallPictures,
) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"], Float[np.ndarray, " steps"]]:
    """Return how well the edges of each frame match those of the next.

    The three are the correlation without a shift, the one at the best shift, and that shift
    [pixels]. A picture with few edges counts little beside one of the same frame with many. Edges
    that match without a shift, and whose neighbors in time do, are not shifted.
    """
    maps = [np.stack([height_edges(height, pictures.filled_m) for height in pictures.height_m])]
    if pictures.color is not None:
        maps.append(np.stack([color_edges(color) for color in pictures.color]))
    centered = [np.float32(each - each.mean(axis=(1, 2), keepdims=True)) for each in maps]
    squares = [np.einsum("fij,fij->f", each, each).astype(np.float64) for each in centered]
    usual = [max(float(np.mean(each)), 1e-12) for each in squares]
    scale = sum(np.sqrt(a[1:] * a[:-1]) / u for a, u in zip(squares, usual, strict=True))
    scale = np.maximum(scale, 1e-12)
    products = [np.einsum("fij,fij->f", each[1:], each[:-1]) for each in centered]
    as_recorded = sum(a / u for a, u in zip(products, usual, strict=True)) / scale
    fit, away = as_recorded.copy(), np.zeros(len(scale))
    moved = np.convolve(as_recorded < 1.0 - _LEAST_GAIN, [1, 1, 1], "same") > 0
    for step in np.flatnonzero(moved):
        pair = [np.fft.rfft2(each[step : step + 2]) / u**0.5
                for each, u in zip(centered, usual, strict=True)]  # fmt: skip
        size = centered[0].shape[1:]
        fits = np.fft.irfft2(sum(one[1] * one[0].conj() for one in pair), s=size) / scale[step]
        best = np.array(np.unravel_index(fits.argmax(), size))
        half = np.array(size) // 2
        fit[step], away[step] = fits.max(), np.hypot(*((best + half) % size - half))
    return as_recorded, fit, away


def _finding(pictures: SmallPictures, since: int, by: _Motion, shown: str) -> Finding:
    measured, limit, unit = by
    most = f"{1e3 * limit:.1f} mm" if unit == "m" else f"{limit:.0f} pixels"
    return Finding(
        "camera_moved", measured, limit, unit, "frames",
        f"camera {pictures.camera.name!r} was pushed before frame {since}: {shown} (at most "
        f"{most}); keep the frames up to {since - 1} alone, or record again",
    )  # fmt: skip
