"""Colors of the observed points and of the cloth, from the pictures of a recording."""

import logging
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from clothtrack.errors import ClothTrackError
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.report.palette import OBSERVED, UNKNOWN, rgb255
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

log = logging.getLogger(__name__)

PALETTE_SIZE = 255
"""Largest number of point colors, so that an index fits one byte."""

_DEPTH_AGREES_M = 0.02
"""Depth difference above which a pixel shows something other than the point [m]."""

_FILM_STEPS = 16
"""Number of frames from which the color of the cloth is taken."""

_SPREADING_ROUNDS = 64
"""Distance that colors spread into parts that no camera saw [edges]."""

_Colors = UInt8[np.ndarray, "points 3"]


def _point_colors(
    recording: Recording, frame: Frame, points: Float[np.ndarray, "points 3"]
) -> tuple[_Colors, Bool[np.ndarray, " points"]]:
    """Return the RGB of each point [m, world], and whether a picture shows the point."""
    colors = np.tile(np.array(rgb255(OBSERVED), np.uint8), (len(points), 1))
    found = np.zeros(len(points), bool)
    for camera in recording.cameras:
        if camera.name not in frame.color:
            continue
        try:
            picture = read_color(frame.color[camera.name])
            depth = None
            if camera.name in frame.depth:
                unit = recording.depth_units_m[camera.name]
                depth = read_depth(frame.depth[camera.name], unit)
        except ClothTrackError as error:
            log.warning("frame %d of %s: no color (%s)", frame.index, recording.name, error)
            continue
        pixels, z = camera.project(np.asarray(points, np.float64))
        with np.errstate(invalid="ignore"):
            column, row = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64).T
        height, width = picture.shape[:2]
        fresh = (z > 1e-3) & (column >= 0) & (column < width) & (row >= 0) & (row < height) & ~found
        if depth is not None:
            fresh[fresh] &= np.abs(depth[row[fresh], column[fresh]] - z[fresh]) < _DEPTH_AGREES_M
        colors[fresh] = picture[row[fresh], column[fresh]]
        found |= fresh
    return colors, found


def cloud_colors(
    recording: Recording, frames: Sequence[Frame], clouds: Sequence[Float[np.ndarray, "_ 3"]]
) -> list[UInt8[np.ndarray, "_ 3"]]:
    """Return the RGB of the observed points per frame; empty if no frame has a picture."""
    if not any(frame.color for frame in frames):
        return []
    pairs = zip(frames, clouds, strict=True)
    return [_point_colors(recording, frame, points)[0] for frame, points in pairs]


def vertex_colors(
    tracked: TrackedTrajectory, recording: Recording
) -> UInt8[np.ndarray, "vertices 3"] | None:
    """Return the mean RGB of each vertex over frames that show it; None without color.

    A vertex that no frame shows takes the color of its neighbors.
    """
    frames = {frame.index: frame for frame in recording.frames}
    sums, counts = np.zeros(tracked.mesh.vertices.shape), np.zeros(tracked.mesh.vertex_count)
    count = len(tracked.frames)
    for step in np.unique(np.linspace(0, count - 1, min(count, _FILM_STEPS)).round().astype(int)):
        frame = frames.get(int(tracked.frames[step]))
        if frame is None or not frame.color:
            continue
        colors, found = _point_colors(recording, frame, tracked.positions[step])
        found &= tracked.visible[step]
        sums[found] += colors[found]
        counts[found] += 1
    if not counts.any():
        return None
    return _spread(sums, counts, tracked.mesh.edges)


def few_colors(
    colors: Float[np.ndarray, "points 3"], count: int
) -> tuple[UInt8[np.ndarray, "kept 3"], UInt8[np.ndarray, " points"]]:
    """Return the `count` most frequent colors, and the index of the nearest for each point."""
    if not len(colors):
        return np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8)
    coarse = (colors.astype(np.int64) >> 3) @ (1 << 10, 1 << 5, 1)
    cells, members, sizes = np.unique(coarse, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(members, channel) / sizes for channel in colors.T], axis=1)
    kept = means[np.argsort(-sizes, kind="stable")[:count]]
    nearest = cKDTree(kept).query(means)[1]
    assert len(cells) == len(nearest)
    return np.rint(kept).astype(np.uint8), nearest[members].astype(np.uint8)


def _spread(
    sums: Float[np.ndarray, "vertices 3"],
    counts: Float[np.ndarray, " vertices"],
    edges: Int[np.ndarray, "edges 2"] | Sequence[Sequence[int]],
) -> UInt8[np.ndarray, "vertices 3"]:
    both = np.concatenate([np.asarray(edges), np.asarray(edges)[:, ::-1]])
    size = len(counts)
    near = csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(size, size))
    known = counts > 0
    colors = np.where(known[:, None], sums / np.maximum(counts, 1)[:, None], 0.0)
    for _ in range(_SPREADING_ROUNDS):
        weight = near @ known.astype(np.float64)
        reached = ~known & (weight > 0)
        if not reached.any():
            break
        mixed = near @ np.where(known[:, None], colors, 0.0)
        colors[reached] = mixed[reached] / weight[reached, None]
        known |= reached
    colors[~known] = rgb255(UNKNOWN)
    return np.rint(colors).astype(np.uint8)
