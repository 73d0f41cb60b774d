"""Points of the cloth, followed from picture to picture by their appearance.

Depth does not show cloth sliding along itself, but a print, a weave or a seam does. Small windows
are followed from each picture to the next (`optical_flow`). A point lost under a tool, in a fold or
in a fast move is searched again as it last appeared. Plain cloth has nothing to follow.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import LEAST_JUMP_M, CameraView, camera_views
from clothtrack.recordings.numbered_points import NumberedPoints
from clothtrack.recordings.optical_flow import (
    WINDOW_PX,
    carried,
    even_picture,
    matched,
    moved_with,
)
from clothtrack.recordings.point_cloud import FollowedPoints
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter, bounds_of

_SPACING_PX = 10
"""At most one point is chosen per cell of this side [pixels]."""

_LARGEST_ERROR_PX = 0.2
"""Largest error of a window's place [pixels]: one standard deviation, from its contrast and the
noise of the picture (the Cramer-Rao bound of its shift)."""

_SLOPES_OF_NOISE = WINDOW_PX**2 * 0.23
"""Squared slopes of a window that shows only noise of one gray value: 0.23 per pixel by Scharr's
weights."""

_LEAST_NOISE = 0.5
"""Least noise assumed of a picture [gray values, 0 to 255]; rounding is 0.3."""

_LOOK_AGAIN = 5
"""Lost points are searched every so many frames after their loss, and where actions begin and end.
Points that were lost in the same frame are searched together, so that no frame has to search for
all."""

_KEPT_PICTURES = 80
"""Number of pictures kept for the lost points that they were the last to show; older pictures are
forgotten with their points."""

_BESIDE_PX = 3.0
"""Largest distance of a lost point from where its neighbors have moved [pixels]: less than half of
a weave's repeat."""

SMOOTH_PX = 5
"""Depth is averaged over a square of this side [pixels]: one pixel is noisy, or not measured."""

LEAST_MEASURED = 0.4
"""Share of that square that must have been measured."""

_STEEP_PX = 12.0
"""A change of depth within that square by the width of so many pixels on the cloth, plus 4 mm, is a
step and not a slope: a window there shows two layers."""

_AROUND_PX = 2 * SMOOTH_PX
"""Margin around the cloth in which depth is smoothed [pixels]; a pixel's value depends on less."""


class PointFollower:
    """The points of the cloth that are followed frame by frame, chosen where actions begin."""

    def __init__(
        self, recording: Recording, segmenter: Segmenter | None = None, *, kept: int | None = None
    ) -> None:
        """Follow nothing yet."""
        self._recording, self._segmenter = recording, segmenter
        numbers = itertools.count()
        self._followers = {camera.name: _Follower(camera, numbers) for camera in recording.cameras}
        self._found: dict[int, FollowedPoints] = {}
        self._next, self._kept = 0, kept

    def knows(self, frame: Frame) -> bool:
        """Return whether points were already followed to a frame; it needs no pictures then."""
        return frame.index < self._next

    def __call__(self, frame: Frame, views: Sequence[CameraView]) -> FollowedPoints:
        """Return the points in a frame, after following them through the frames before it."""
        for skipped in self._recording.frames[self._next : frame.index]:
            self._follow(
                skipped, camera_views(self._recording, skipped, self._segmenter, color=True)
            )
        if not self.knows(frame):
            self._follow(frame, views)
        return self._found.get(frame.index, FollowedPoints())

    def _follow(self, frame: Frame, views: Sequence[CameraView]) -> None:
        """Follow the points to the next frame."""
        # Read anew for every frame, because the actions of a live recording grow.
        actions = self._recording.actions
        choose = any(frame.index == action.first_frame for action in actions)
        ends = any(frame.index == action.last_frame for action in actions)
        parts = [
            self._followers[view.camera.name].follow(
                _Picture.of(view, view.color), frame.index, choose=choose, ends=ends
            )
            for view in views
            if view.color is not None
        ]
        self._found[frame.index], self._next = _together(parts), frame.index + 1
        if self._kept is not None:
            self._found.pop(frame.index - self._kept, None)


def _together(parts: list[FollowedPoints]) -> FollowedPoints:
    if not parts:
        return FollowedPoints()
    numbers = np.concatenate([part.numbers for part in parts])
    positions = np.concatenate([part.positions for part in parts])
    order = np.argsort(numbers)
    return FollowedPoints(numbers[order], positions[order])


@dataclass(frozen=True, eq=False)
class _Picture:
    """The picture of one camera in one frame.

    Attributes:
        even: brightness of the cloth, normalized for the light on it (`even_picture`).
        depth: smoothed depth of the cloth and around it [m]; 0 elsewhere.
        clear: pixels whose window shows one layer of cloth and nothing else.
    """

    gray: UInt8[np.ndarray, "height width"]
    even: UInt8[np.ndarray, "height width"]
    depth: Float32[np.ndarray, "height width"]
    clear: Bool[np.ndarray, "height width"]

    @classmethod
    def of(cls, view: CameraView, color: UInt8[np.ndarray, "height width 3"]) -> "_Picture":
        """Return the picture of a view, with the pixels whose windows may be compared."""
        # Nothing is followed outside the cloth, so only the part around it is computed.
        part = bounds_of(view.mask, margin=_AROUND_PX)
        window = np.ones((WINDOW_PX, WINDOW_PX), np.uint8)
        shown = cv2.erode(view.mask[part].view(np.uint8), window, borderValue=0).view(bool)
        measured = (~view.blind[part]).astype(np.float32)
        square = np.ones((SMOOTH_PX, SMOOTH_PX), np.uint8)
        share = cv2.blur(measured, square.shape)
        smooth = cv2.blur(measured * view.depth_m[part], square.shape)
        smooth /= np.maximum(share, 1e-6)
        step = cv2.dilate(smooth, square) - cv2.erode(smooth, square)
        shown &= (share > LEAST_MEASURED) & (
            step < LEAST_JUMP_M + _STEEP_PX / view.camera.fx * smooth
        )
        clear, depth = np.zeros(view.mask.shape, bool), np.zeros(view.mask.shape, np.float32)
        clear[part], depth[part] = shown, smooth
        gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        return cls(gray, even_picture(gray, view.mask), depth, clear)

    def noise_since(self, before: "_Picture | None") -> float:
        """Return the standard deviation of the noise between two pictures [gray values].

        Most of what they show stands still.
        """
        if before is None:
            return _LEAST_NOISE
        change = float(np.median(cv2.absdiff(self.gray, before.gray)))
        return max(_LEAST_NOISE, 1.4826 * change / np.sqrt(2.0))

    def shows(self, pixels: Float32[np.ndarray, "points 2"]) -> Bool[np.ndarray, " points"]:
        """Return whether a window around each pixel shows one layer of cloth."""
        column, row = np.rint(pixels).astype(np.int64).T
        height, width = self.clear.shape
        shown = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        shown[shown] = self.clear[row[shown], column[shown]]
        return shown

    def in_world(
        self, pixels: Float32[np.ndarray, "points 2"], camera: Camera
    ) -> Float[np.ndarray, "points 3"]:
        """Return the positions of the cloth at these pixels, in the world [m]."""
        if not len(pixels):
            return np.zeros((0, 3))
        depth = cv2.remap(self.depth, pixels[:, None, 0], pixels[:, None, 1], cv2.INTER_LINEAR)
        aside = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        local = np.column_stack([aside, np.ones(len(pixels))]) * depth.astype(np.float64)
        return local @ camera.world_from_camera[:3, :3].T + camera.position


@dataclass(frozen=True, eq=False)
class _Lost:
    """Points that were lost from one picture to the next.

    Attributes:
        numbers: numbers of all points that were followed in it.
        pixels: their places in it [pixels].
    """

    frame: int
    even: UInt8[np.ndarray, "height width"]
    points: NumberedPoints
    numbers: Int[np.ndarray, " others"]
    pixels: Float32[np.ndarray, "others 2"]

    def found_in(self, picture: _Picture, followed: NumberedPoints) -> NumberedPoints:
        """Return the points that a later picture shows near where the others have moved."""
        _, then, now = np.intersect1d(
            self.numbers, followed.numbers, assume_unique=True, return_indices=True
        )
        moves = followed.pixels[now] - self.pixels[then]
        guess, near = moved_with(self.points.pixels, self.pixels[then], moves)
        points, guess = self.points[near], guess[near]
        there, found = matched(self.even, picture.even, points.pixels, guess)
        found &= np.linalg.norm(there - points.pixels - guess, axis=1) < _BESIDE_PX
        found &= picture.shows(there)
        return replace(points, pixels=there, steps=np.zeros_like(there))[found]

    def is_due(self, frame: int) -> bool:
        """Return whether they are to be searched in a frame."""
        return frame > self.frame and (frame - self.frame) % _LOOK_AGAIN == 0

    def without(self, followed: NumberedPoints) -> "_Lost":
        """Return the points that are still lost."""
        return replace(self, points=self.points[~self.points.are_in(followed)])


class _Follower:
    """Follows the points that one camera sees."""

    def __init__(self, camera: Camera, numbers: Iterator[int]) -> None:
        self._camera, self._numbers = camera, numbers
        self._before: _Picture | None = None
        self._points = NumberedPoints.none()
        self._lost: list[_Lost] = []

    def follow(self, picture: _Picture, frame: int, *, choose: bool, ends: bool) -> FollowedPoints:
        """Return the points in the next picture."""
        if self._before is not None:
            self._carry(self._before, picture, frame)
        self._look_again(picture, None if choose or ends else frame)
        if choose:
            self._choose(picture)
        self._before = picture
        return FollowedPoints(self._points.numbers.copy(), self._positions(self._points, picture))

    def _positions(
        self, points: NumberedPoints, picture: _Picture
    ) -> Float[np.ndarray, "points 3"]:
        return picture.in_world(points.pixels, self._camera)

    def _carry(self, before: _Picture, picture: _Picture, frame: int) -> None:
        """Follow all points from the previous picture."""
        old = self._points
        there, found = carried(before.even, picture.even, old.pixels, old.steps)
        moved = old.at(there)[found & picture.shows(there)]
        self._points = moved[moved.near_each_other(self._positions(moved, picture))]
        lost = _Lost(frame, before.even, old, old.numbers, old.pixels).without(self._points)
        self._lost = [*self._lost, *([lost] if len(lost.points) else [])][-_KEPT_PICTURES:]

    def _look_again(self, picture: _Picture, frame: int | None) -> None:
        """Add lost points that are seen again beside their former neighbors.

        Only the points due in the frame are searched; all if it is None.
        """
        due = [one for one in self._lost if frame is None or one.is_due(frame)]
        back = NumberedPoints.none()
        for lost in due:
            back = back.together_with(lost.found_in(picture, self._points))
        if len(back):
            points = self._points.together_with(back)
            near = points.near_each_other(self._positions(points, picture))
            self._points = points[near | ~points.are_in(back)]
        left = [lost.without(self._points) for lost in self._lost]
        self._lost = [lost for lost in left if len(lost.points)]

    def _choose(self, picture: _Picture) -> None:
        """Add points; from now on each has to stay near those that are beside it here."""
        noise = picture.noise_since(self._before)
        fresh = _chosen(picture, noise, self._points.pixels)
        numbers = np.fromiter(itertools.islice(self._numbers, len(fresh)), np.int64, len(fresh))
        points = self._points.together_with(NumberedPoints.fresh(numbers, fresh))
        self._points = points.with_neighbors(self._positions(points, picture))


def _chosen(
    picture: _Picture, noise: float, taken: Float32[np.ndarray, "taken 2"]
) -> Float32[np.ndarray, "fresh 2"]:
    """Return the best pixel of each empty cell whose window can be located well."""
    weakest = _weakest_contrast(picture.gray)
    # Noise has slopes, too, which carry no information.
    tells = picture.clear & (weakest > (_LARGEST_ERROR_PX**-2 + _SLOPES_OF_NOISE) * noise**2)
    row, column = np.nonzero(tells)
    if not len(row):
        return np.zeros((0, 2), np.float32)
    cells_across = -(-picture.gray.shape[1] // _SPACING_PX)
    cell = row // _SPACING_PX * cells_across + column // _SPACING_PX
    order = np.lexsort((-weakest[row, column], cell))
    best = order[np.unique(cell[order], return_index=True)[1]]
    over, down = np.rint(taken).astype(np.int64).T // _SPACING_PX
    best = best[~np.isin(cell[best], down * cells_across + over)]
    return np.stack([column[best], row[best]], axis=1).astype(np.float32)


def _weakest_contrast(
    gray: UInt8[np.ndarray, "height width"],
) -> Float32[np.ndarray, "height width"]:
    """Return the squared slopes, summed over the window, in the direction in which they are least.

    The noise of the picture divided by the root of this sum is the error of the window's place
    [pixels] (J. Shi and C. Tomasi, "Good features to track", doi:10.1109/CVPR.1994.323794).
    """
    picture = gray.astype(np.float32)
    # Scharr's weights add up to 32; the scale gives slopes per pixel.
    across, down = (
        cv2.Scharr(picture, cv2.CV_32F, *axis, scale=1.0 / 32.0) for axis in ((1, 0), (0, 1))
    )
    window = (WINDOW_PX, WINDOW_PX)
    xx, xy, yy = (
        cv2.boxFilter(product, -1, window, normalize=False)
        for product in (across * across, across * down, down * down)
    )
    return 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
