"""Measures of a camera: depth unit and pose by the table in its depth, its lens, and its motion."""

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.table_plane import TableFit
from clothtrack.recordings.geometry_checks.finding import Measured, ObservedFrames, unit_factor
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.pictures import read_depth
from clothtrack.recordings.recorded_table import fit_recorded_table
from clothtrack.recordings.recording import Table

LARGEST_TILT_DEG, LARGEST_SHIFT_M = 1.0, 0.01
"""Angle and distance of the recorded table and the one in the depth from which a pose is doubted.
On right recordings they are below 0.1 degrees and 1 mm; 1 degree lifts a cloth of 0.4 m by 7 mm."""

_SPREAD = 0.1
"""Largest difference between pixels of the ratio of measured and expected depth (quartiles of its
logarithm), because a wrong unit makes all depth wrong by one factor."""

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Transform from a camera frame with y up and z backward (OpenGL) to ours."""

_WHOLE_PICTURES = (4 / 3, 16 / 9, 16 / 10, 5 / 4)
"""Ratios of the sides of pictures as sensors give them. Others may have been cut out of a larger
picture, whose principal point may be anywhere."""

_EVERY = 2
"""Stride along each axis of the reduced pixels that the table is fitted to; thousands suffice."""

_NEAR_TABLE_M, _MOST_CHANGE_M = 0.03, 0.08
"""Pixels of the first frames this near to the recorded table [m] may be the table; those whose
height changes by more than the second show a hand."""

LARGEST_MOTION_M = 0.0025
"""Change of the table's height somewhere in the picture [m] up to which the camera stands still.
It is below 0.4 mm on right recordings; a camera turned by 1 degree makes 7."""

_INLIER_M, _FEWEST_INLIERS = 0.005, 0.6
"""Share of the table's pixels that must agree within so much [m] on how the table moved."""

_LEAST_JUMP, _MOST_JUMP = 2.5, 15.0
"""Limits of the shift of the whole picture between two frames [reduced pixels, 1/160 of the width]
that is a push. A hand that moves fast looks like a larger shift."""

_LEAST_FIT, _LEAST_GAIN = 0.58, 0.15
"""Correlation of the edges that the shift must reach, and by how much it must exceed none's."""


def table_depths(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield depth that is that of the recorded table in another unit."""
    recording = frames.recording
    for place, camera in _with_depth(frames):
        frame = next(frame for frame in recording.frames if camera.name in frame.depth)
        depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
        normal, height = _recorded(camera.world_from_camera, frames.table)
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        away = -(
            (columns - camera.cx) / camera.fx * normal[0]
            + (rows - camera.cy) / camera.fy * normal[1]
            + normal[2]
        )
        seen = (depth > 0) & (away > 1e-3)
        if height <= 0 or not seen.any():
            continue
        logs = np.log10(depth[seen] * away[seen] / height)
        low, middle, high = np.percentile(logs, [25, 50, 75])
        factor = unit_factor(float(10.0**middle))
        if factor is not None and high - low <= _SPREAD:
            unit_m = recording.depth_units_m[camera.name]
            yield {
                "measured": float(np.median(depth[seen])),
                "limit": float(np.median(height / away[seen])),
                "place": place, "camera": camera.name, "unit_m": unit_m, "likely": unit_m / factor,
            }  # fmt: skip


def table_tilts(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the angle of the table in the depth against the recorded one [deg]."""
    for place, camera, fit in frames.once(_fits):
        tilt_deg, _ = _apart(fit, _recorded(camera.world_from_camera, frames.table))
        cause = _cause(camera, fit, frames.table)
        yield {"measured": tilt_deg, "place": place, "camera": camera.name, "cause": cause}


def table_shifts(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the distance of a camera from the table where the recorded one is another [m]."""
    for place, camera, fit in frames.once(_fits):
        tilt_deg, shift_m = _apart(fit, _recorded(camera.world_from_camera, frames.table))
        if tilt_deg <= LARGEST_TILT_DEG and abs(shift_m) > LARGEST_SHIFT_M:
            yield {
                "measured": fit.distance_m, "limit": fit.distance_m - shift_m, "place": place,
                "camera": camera.name, "cause": _cause(camera, fit, frames.table),
            }  # fmt: skip


def _with_depth(frames: ObservedFrames) -> Iterator[tuple[int, Camera]]:
    for place, camera in enumerate(frames.recording.cameras):
        if any(camera.name in frame.depth for frame in frames.recording.frames):
            yield place, camera


def _fits(frames: ObservedFrames) -> list[tuple[int, Camera, TableFit]]:
    """Return the table in the depth of each camera that shows a plane."""
    fits = []
    for place, camera in _with_depth(frames):
        try:
            fits.append((place, camera, fit_recorded_table(frames.recording, camera)))
        except InvalidRecordingError:
            continue
    return fits


def _cause(camera: Camera, fit: TableFit, table: Table) -> str:
    """Return the likely mistake in the pose, if another pose fits; else what may be wrong."""
    pose = camera.world_from_camera
    others: Mapping[str, Float[np.ndarray, "4 4"]] = {
        "it looks inverted, the pose of the world in the camera": np.linalg.inv(pose),
        "its y and z look like those of OpenGL, y up and z backward": pose @ _FLIP,
        "it looks inverted and like OpenGL's, y up and z backward": np.linalg.inv(pose) @ _FLIP,
    }
    for words, other in others.items():
        tilt_deg, shift_m = _apart(fit, _recorded(other, table))
        if tilt_deg <= LARGEST_TILT_DEG and abs(shift_m) <= LARGEST_SHIFT_M:
            return f" ({words})"
    return ", or fx, fy, cx and cy of the camera"


def _recorded(
    world_from_camera: Float[np.ndarray, "4 4"], table: Table
) -> tuple[Float[np.ndarray, " 3"], float]:
    """Return the recorded table's normal in a camera at this pose, and its height above it [m]."""
    normal = table.normal / np.linalg.norm(table.normal)
    height = float((world_from_camera[:3, 3] - table.point) @ normal)
    return world_from_camera[:3, :3].T @ normal, height


def _apart(fit: TableFit, recorded: tuple[Float[np.ndarray, " 3"], float]) -> tuple[float, float]:
    """Return the angle [deg] and distance [m] from a recorded table to the one in the depth."""
    normal, height = recorded
    cosine = float(np.clip(fit.normal @ normal, -1.0, 1.0))
    return float(np.degrees(np.arccos(cosine))), fit.distance_m - height


def centers(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the distance of the principal point from the middle, as a share of the side."""
    for place, camera in enumerate(frames.recording.cameras):
        ratio = camera.width / camera.height
        if any(abs(ratio / whole - 1) < 0.01 for whole in _WHOLE_PICTURES):
            x, y = (camera.width - 1) / 2, (camera.height - 1) / 2
            off = abs((camera.cx - x) / camera.width), abs((camera.cy - y) / camera.height)
            yield {"measured": max(off), "place": place, "camera": camera, "x": x, "y": y}


def focal_ratios(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the ratio of the larger and the smaller of fx and fy."""
    for place, camera in enumerate(frames.recording.cameras):
        ratio = max(camera.fx / camera.fy, camera.fy / camera.fx)
        yield {"measured": ratio, "place": place, "camera": camera}


def table_motion(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield by how much the table turns or rises in the picture [m]; cloth and hands may."""
    pictures = frames.pictures
    if len(pictures.frames) < 4:
        return
    heights = pictures.height_m[:, ::_EVERY, ::_EVERY]
    known = np.isfinite(heights[:3])
    first = np.where(known, heights[:3], 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    table = known.any(axis=0) & (np.abs(first) < _NEAR_TABLE_M)
    if pictures.mask is not None:
        table &= (pictures.mask[:, ::_EVERY, ::_EVERY] == 0).all(axis=0)
    moved = np.array([_table_motion_m(height - first, table) for height in heights])
    lasting = np.minimum(moved[:-1], moved[1:])  # A change in a single frame is noise, or an arm.
    since = pictures.frames[int(np.argmax(lasting > LARGEST_MOTION_M))]
    yield {
        "measured": float(lasting.max()), "camera": pictures.camera.name, "since": since,
        "last": since - 1,
    }  # fmt: skip


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
    for _ in range(5):  # After which the reweighted fit is steady.
        weighted = basis / np.square(1.0 + (away / _INLIER_M) ** 2)
        plane = np.linalg.solve(weighted @ basis.T, weighted @ wanted)
        away = wanted - plane @ basis
    if (np.abs(away) < _INLIER_M).mean() < _FEWEST_INLIERS:
        return 0.0
    return float(np.abs(plane).sum())


def picture_jumps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield by how much all edges jump between two frames, and hardly move before and after."""
    pictures = frames.pictures
    if len(pictures.frames) < 4:
        return
    as_recorded, fit, away = _step_shifts(pictures)
    # Constant motion also looks like a jump after a missing frame, so speeds are compared.
    took = np.diff([frames.recording.frames[frame].time_s for frame in pictures.frames])
    speed = away / np.maximum(took, 1e-9)
    beside = took * np.maximum(np.append(speed[1:], 0.0), np.append(0.0, speed[:-1]))
    jump = (away >= _LEAST_JUMP) & (away <= _MOST_JUMP) & (beside <= 0.5 * away)
    jump &= (fit >= _LEAST_FIT) & (fit >= as_recorded + _LEAST_GAIN)
    if jump.any():
        step = int(np.argmax(np.where(jump, fit - as_recorded, -1.0)))
        since = pictures.frames[step + 1]
        yield {
            "measured": float(away[step] * pictures.factor),
            "limit": _LEAST_JUMP * pictures.factor,
            "camera": pictures.camera.name, "since": since, "last": since - 1,
        }  # fmt: skip


def _step_shifts(
    pictures: SmallPictures,
) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, " steps"], Float[np.ndarray, " steps"]]:
    """Return how well the edges of each frame match those of the next.

    The three are the correlation without a shift, the one at the best shift, and that shift
    [pixels]. A picture with few edges counts little beside one of the same frame with many. Edges
    that match without a shift, and whose neighbors in time do, are not shifted.
    """
    centered = [np.float32(each - each.mean(axis=(1, 2), keepdims=True)) for each in pictures.edges]
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
