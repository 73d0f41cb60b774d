"""The observation of the cloth in one frame: points, and where the cameras were blind."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from clothtrack._shown import short_repr
from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import CameraView, camera_views, flying_pixels
from clothtrack.recordings.pictures import read_cloud
from clothtrack.recordings.recording import Frame, Recording, Table
from clothtrack.recordings.segmentation import Segmenter, bounds_of, height_picture

SPACING_M = 0.004
"""Default side of the cubes [m] in which points are averaged."""

_CUT_MARGIN_M = 0.012
_TOOL_HEIGHT_M = 0.015
_STRAY_SHARE = 0.04
"""Clusters with less than this share of the points are not cloth."""
LINK_M = 0.012
"""Distance over which points belong together [m]."""
_MOST_CELLS = 1 << 20
"""Largest number of cubes around the cloth that are marked in a grid; more are sorted."""

_HALF_NEIGHBORS = [
    (x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)
]


@dataclass(frozen=True, eq=False)
class FollowedPoints:
    """Points of the cloth in one frame that are followed from picture to picture.

    Attributes:
        numbers: one per point, ascending; the same number is the same material point in every
            frame.
        positions: positions in the world [m].
    """

    numbers: Int[np.ndarray, " followed"] = field(default_factory=lambda: np.zeros(0, np.int64))
    positions: Float[np.ndarray, "followed 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Observation:
    """The observation of the cloth in one frame.

    Attributes:
        points: points of the cloth in the world [m].
        cameras: the cameras that may have seen it.
        hidden: per camera name, the pixels where cloth could not have been seen: no depth was
            measured, or a tool stands in front. Empty for recordings of clouds.
        lowest_height_m: world height [m] under which points were cut away, or None.
        tool_positions: tip of every picker in the world [m].
        tool_clearance_m: radius around the tips [m] within which points were cut away.
        followed: points that are followed from picture to picture; none unless requested
            (`clothtrack.recordings.point_following`).
    """

    points: Float[np.ndarray, "points 3"]
    cameras: tuple[Camera, ...]
    hidden: Mapping[str, Bool[np.ndarray, "height width"]]
    lowest_height_m: float | None
    tool_positions: Float[np.ndarray, "tools 3"]
    tool_clearance_m: float
    followed: FollowedPoints = field(default_factory=FollowedPoints)

    __repr__ = short_repr

    def unobservable(
        self, vertices: Float[np.ndarray, "vertices 3"]
    ) -> Bool[np.ndarray, " vertices"]:
        """Return which visible vertices may lack a point nearby although they are placed right.

        These are outside every picture or on a hidden pixel of those that they fall in, under the
        cut or less than 12 mm above it, or inside the clearance of a tool. Occlusion of cloth by
        cloth is computed elsewhere (`clothtrack.geometry.visibility`).
        """
        unobservable = np.ones(len(vertices), dtype=bool)
        for camera in self.cameras:
            unobservable &= ~_in_clear_view(vertices, camera, self.hidden.get(camera.name))
        if self.lowest_height_m is not None:
            unobservable |= vertices[:, 2] < self.lowest_height_m + _CUT_MARGIN_M
        for tip in self.tool_positions:
            unobservable |= np.linalg.norm(vertices - tip, axis=1) < self.tool_clearance_m
        return unobservable


def observe(
    recording: Recording,
    frame: Frame,
    segmenter: Segmenter | None = None,
    *,
    spacing_m: float | None = SPACING_M,
) -> Observation:
    """Return the points of the cloth in the world, from all cameras or from the frame's cloud.

    Args:
        recording: the recording.
        frame: one of its frames.
        segmenter: finds the cloth; by default masks, color hint or height (`default_segmenter`).
        spacing_m: side of the cubes [m] in which points are averaged; None keeps every pixel.

    Raises:
        InvalidRecordingError: a file cannot be read, or no cloth is found.
    """
    views = camera_views(recording, frame, segmenter)
    return observation_of(recording, frame, views, spacing_m=spacing_m)


def observation_of(
    recording: Recording,
    frame: Frame,
    views: Sequence[CameraView],
    *,
    spacing_m: float | None = SPACING_M,
) -> Observation:
    """Return the points of the cloth in the world, from camera views or from the frame's cloud.

    Args:
        spacing_m: side of the cubes [m] in which points are averaged; None keeps every pixel.
    """
    clouds: list[Float[np.ndarray, "points 3"]] = []
    hidden: dict[str, Bool[np.ndarray, "height width"]] = {}
    pixel_m = 0.0
    for view in views:
        camera, depth = view.camera, view.depth_m
        hidden[camera.name] = hidden_pixels(depth, view.mask, view.blind, camera, recording.table)
        shown = view.mask & ~view.blind
        clouds.append(camera.back_project(depth, shown))
        if len(clouds[-1]):
            window = bounds_of(shown)
            middle = float(np.median(depth[window][shown[window]]))
            pixel_m = max(pixel_m, middle / camera.fx)
    if frame.cloud is not None:
        # The recording's own merged cloud replaces those of all cameras.
        clouds = [read_cloud(frame.cloud)]
    points = np.concatenate(clouds) if clouds else np.zeros((0, 3))
    if spacing_m is not None:
        points = thin(points, spacing_m)
    spread_m = max(pixel_m, spacing_m or 0.0)
    points = points.compress(~strays(points, _STRAY_SHARE, spacing_m=spread_m), axis=0)
    if not len(points):
        raise InvalidRecordingError(
            f"{recording.folder}: no cloth is found in frame {frame.index}; look at its mask "
            "(or cloth.color) and whether the depth has measurements there"
        )
    tips = [path.position_at(frame.time_s) for path in recording.picker_paths.values()]
    return Observation(
        points=points,
        cameras=recording.cameras,
        hidden=hidden,
        lowest_height_m=recording.observed.lowest_height_m,
        tool_positions=np.array(tips, dtype=np.float64).reshape(-1, 3),
        tool_clearance_m=recording.observed.tool_clearance_m,
    )


def hidden_pixels(
    depth_m: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"],
    blind: Bool[np.ndarray, "height width"],
    camera: Camera,
    table: Table | None,
) -> Bool[np.ndarray, "height width"]:
    """Return the pixels where cloth could not have been seen, with two pixels around them.

    These are the blind pixels and those of the tool, which show neither cloth nor table but
    something more than 15 mm above the table. Specks narrower than three pixels hide nothing,
    because the cloth beside them was seen. (Real depth is full of them: with specks, 99.8 % of the
    pixels of a well measured hanging cloth would count as hidden.) Without a table, everything
    outside the mask is background, measured or not.
    """
    if table is None:
        unseen = blind & mask
    else:
        unseen = height_picture(depth_m, camera, table) > _TOOL_HEIGHT_M
        unseen &= (depth_m > 0) & ~mask
        unseen |= blind
    cores = cv2.erode(unseen.view(np.uint8), np.ones((3, 3), np.uint8))
    # Restore one pixel to their size, and add two around them.
    return cv2.dilate(cores, np.ones((7, 7), np.uint8)).view(bool)


def thin(
    points: Float[np.ndarray, "points 3"], spacing_m: float
) -> Float[np.ndarray, "fewer_points 3"]:
    """Return the mean of the points in every cube of the given side [m]."""
    if not len(points):
        return points
    members = _cell_numbers(points, spacing_m)
    counts = np.bincount(members)
    return np.stack([np.bincount(members, axis) / counts for axis in points.T], axis=1)


def strays(
    points: Float[np.ndarray, "points 3"],
    share: float,
    *,
    spacing_m: float = 0.0,
) -> Bool[np.ndarray, " points"]:
    """Return the points of clusters that hold less than a share of all points.

    Points are linked if their cubes, whose diagonal is `LINK_M`, touch: points nearer than 0.58
    `LINK_M` are always linked, points farther apart than 2 `LINK_M` never.

    Args:
        points: points [m].
        spacing_m: distance [m] of neighboring points; cubes are at least 1.5 times as large.
    """
    if not len(points) or share <= 0:
        return np.zeros(len(points), dtype=bool)
    side = max(LINK_M / np.sqrt(3.0), 1.5 * spacing_m)
    cluster_of_point = _clusters(points, side)
    sizes = np.bincount(cluster_of_point)
    least = min(share * len(points), sizes.max())
    return sizes[cluster_of_point] < least


def cloth_measured(
    depth_m: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"],
    camera: Camera,
) -> Bool[np.ndarray, "height width"]:
    """Return the pixels of a mask where the cloth was measured.

    Flying pixels and specks of other things are left out, because the rim of a mask often shows a
    little of what is behind the cloth.

    Args:
        depth_m: measured depth [m]; 0 where nothing was measured.
    """
    shown = mask & (depth_m > 0) & ~flying_pixels(depth_m, camera.fx)
    if shown.any():
        points = camera.back_project(depth_m, shown)
        spacing_m = float(np.median(depth_m[shown])) / camera.fx
        shown[shown] = ~strays(points, _STRAY_SHARE, spacing_m=spacing_m)
    return shown


def _clusters(points: Float[np.ndarray, "points 3"], side_m: float) -> Int[np.ndarray, " points"]:
    """Return the cluster number of each point.

    Touching cubes that contain points belong together.
    """
    place, shape = _places(points, points.mean(axis=0), side_m)
    if np.prod(shape) <= _MOST_CELLS:
        place = place.astype(np.intp)
        filled = np.zeros([int(count) for count in shape], dtype=bool)
        filled.ravel()[place] = True
        return label(filled, np.ones((3, 3, 3)))[0].ravel()[place]
    cells, members = np.unique(_cells(points, side_m), return_inverse=True)
    first, second = [], []
    for x, y, z in _HALF_NEIGHBORS:
        wanted = cells + ((x << 42) + (y << 21) + z)
        place = np.minimum(np.searchsorted(cells, wanted), len(cells) - 1)
        linked = np.flatnonzero(cells[place] == wanted)
        first.append(linked)
        second.append(place[linked])
    rows, columns = np.concatenate(first), np.concatenate(second)
    links = coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(len(cells),) * 2)
    return connected_components(links, directed=False)[1][members]


def _cell_numbers(
    points: Float[np.ndarray, "points 3"], side_m: float
) -> Int[np.ndarray, " points"]:
    """Return the number of each point's cube, in the order of `_cells` and without gaps."""
    place, shape = _places(points, [axis.mean() for axis in points.T], side_m)
    if not np.prod(shape) <= _MOST_CELLS:
        return np.unique(_cells(points, side_m), return_inverse=True)[1]
    place = place.astype(np.intp)
    # Nearly all of a box around a cloth is empty, so sums over all its cubes would be slow.
    filled = np.zeros(place.max() + 1, dtype=bool)
    filled[place] = True
    cells = np.flatnonzero(filled)
    filled_before = np.empty(len(filled), dtype=np.intp)
    filled_before[cells] = np.arange(len(cells))
    return filled_before.take(place)


def _places(
    points: Float[np.ndarray, "points 3"], middle: Iterable[float], side_m: float
) -> tuple[Float[np.ndarray, " points"], list[float]]:
    """Return the index of each point's cube in a box around all, and the box's cubes per axis."""
    place = np.zeros(len(points))
    shape = []
    # Axis by axis, because operations along rows of three are slow.
    for axis, at in zip(points.T, middle, strict=True):
        index = np.floor((axis - at) / side_m)
        lowest = index.min()
        shape.append(index.max() - lowest + 1.0)
        place = place * shape[-1] + (index - lowest)
    return place, shape


def _cells(points: Float[np.ndarray, "points 3"], side_m: float) -> Int[np.ndarray, " points"]:
    # 21 bits per axis, in the middle of their range: neighbors differ by a constant.
    index = np.floor((points - points.mean(axis=0)) / side_m).astype(np.int64) + (1 << 20)
    index = np.clip(index, 1, (1 << 21) - 2)
    return (index[:, 0] << 42) | (index[:, 1] << 21) | index[:, 2]


def _in_clear_view(
    vertices: Float[np.ndarray, "vertices 3"],
    camera: Camera,
    hidden: Bool[np.ndarray, "height width"] | None,
) -> Bool[np.ndarray, " vertices"]:
    pixels, depth = camera.project(vertices)
    with np.errstate(invalid="ignore"):
        inside = (
            (depth > 0)
            & (pixels > -0.5).all(axis=1)
            & (pixels < (camera.width - 0.5, camera.height - 0.5)).all(axis=1)
        )
    if hidden is not None:
        columns, rows = np.rint(pixels[inside]).astype(np.int64).T
        inside[inside] = ~hidden[rows, columns]
    return inside
