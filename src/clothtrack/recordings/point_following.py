"""Points of the cloth, followed from picture to picture by what they look like.

A depth camera does not see cloth slide along itself; a print, a weave or a seam shows it. Small
windows are followed from each picture to the next (B. Lucas and T. Kanade, "An iterative image
registration technique with an application to stereo vision", IJCAI 1981) and back again, and kept
where they come home (Z. Kalal, K. Mikolajczyk, J. Matas, "Forward-backward error: automatic
detection of tracking failures", doi:10.1109/ICPR.2010.675). Plain cloth has nothing to follow. What
is lost under a tool or in a fold is recognised later, where there is a print (`recognition`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from scipy.spatial import cKDTree

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.known_masks import KnownMasks
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.point_cloud import LEAST_JUMP_M, FollowedPoints, flying_pixels
from clothtrack.recordings.recognition import NEIGHBOURS, KeyPoints, Recogniser, too_far_apart
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter, default_segmenter, main_components

WINDOW_PX = 15
"""Side of the window that is compared [pixels]."""

SPACING_PX = 10
"""At most one point is chosen per cell of this side [pixels]."""

LARGEST_ERROR_PX = 0.1
"""A window must tell where it is to so much [pixels]: one standard deviation, from its contrast and
the noise of the picture (the Cramer-Rao bound of its shift)."""

LEAST_NOISE = 1.0
"""Noise of a picture [grey values, 0 to 255] that is reckoned with in any case."""

HOME_PX = 0.5
"""A point that ends farther from home than this [pixels] when it is followed back is lost."""

SMOOTH_PX = 5
"""Depth is averaged over a square of this side [pixels]: one pixel is noisy, or not measured."""

LOOK_AGAIN = 5
"""Points that were lost are looked for in every so many frames, and where actions begin and end."""

LEAST_MEASURED = 0.4
"""Share of that square that must have been measured."""

STEEP_PX = 12.0
"""Depth that changes within that square by so many pixels' width of the cloth, and 4 mm, is no
slope but a step: a window there shows two layers."""


def follow_points(
    recording: Recording,
    segmenter: Segmenter | None = None,
    *,
    masks: Mapping[int, KnownMasks] | None = None,
) -> Mapping[int, FollowedPoints]:
    """The points of the cloth that can be followed, by frame; chosen where actions begin.

    Args:
        recording: a recording of clouds has none.
        segmenter: finds the cloth; the recording's masks, colour or height by default.
        masks: get what it finds, by the index of the frame.

    Returns:
        What is followed, by the index of the frame.

    Raises:
        InvalidRecordingError: a picture cannot be read.
    """
    starts = {action.first_frame for action in recording.actions}
    ends = {action.last_frame for action in recording.actions}
    found: dict[int, list[FollowedPoints]] = {frame.index: [] for frame in recording.frames}
    next_number = 0
    for camera in recording.cameras:
        follower = _Follower(camera, next_number)
        for frame in recording.frames:
            if camera.name in frame.color and camera.name in frame.depth:
                picture, mask = _Picture.read(recording, frame, camera, segmenter)
                if masks is not None:
                    masks[frame.index].keep(camera, mask)
                look = frame.index in starts | ends or frame.index % LOOK_AGAIN == 0
                followed = follower.follow(picture, choose=frame.index in starts, look=look)
                found[frame.index].append(followed)
            else:
                follower.lose_all()
        next_number = follower.next_number
    return {index: _together(parts) for index, parts in found.items()}


def _together(parts: list[FollowedPoints]) -> FollowedPoints:
    if not parts:
        return FollowedPoints()
    return FollowedPoints(
        np.concatenate([part.numbers for part in parts]),
        np.concatenate([part.positions for part in parts]),
    )


@dataclass(frozen=True, eq=False)
class _Picture:
    """What one camera saw in one frame.

    Attributes:
        gray: brightness.
        depth: smoothed depth [m].
        clear: where a window shows one layer of cloth and nothing else.
    """

    gray: UInt8[np.ndarray, "height width"]
    depth: Float32[np.ndarray, "height width"]
    clear: Bool[np.ndarray, "height width"]

    @classmethod
    def read(
        cls, recording: Recording, frame: Frame, camera: Camera, segmenter: Segmenter | None
    ) -> "tuple[_Picture, Bool[np.ndarray, 'height width']]":
        """Read a frame's pictures and find where windows may be compared; and the cloth's mask."""
        color = read_color(frame.color[camera.name])
        depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
        find = segmenter or default_segmenter(recording, frame, camera)
        mask = main_components(find(color, depth, camera, recording.table))
        window = np.ones((WINDOW_PX, WINDOW_PX), np.uint8)
        clear = cv2.erode(mask.view(np.uint8), window, borderValue=0).view(bool)
        measured = ((depth > 0) & ~flying_pixels(depth, camera.fx)).astype(np.float32)
        square = np.ones((SMOOTH_PX, SMOOTH_PX), np.uint8)
        share = cv2.blur(measured, square.shape)
        smooth = cv2.blur(measured * depth.astype(np.float32), square.shape)
        smooth /= np.maximum(share, 1e-6)
        step = cv2.dilate(smooth, square) - cv2.erode(smooth, square)
        clear &= (share > LEAST_MEASURED) & (step < LEAST_JUMP_M + STEEP_PX / camera.fx * smooth)
        return cls(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), smooth, clear), mask

    def noise_since(self, before: "_Picture | None") -> float:
        """Standard deviation [grey values]; most of what two pictures show stands still."""
        if before is None:
            return LEAST_NOISE
        change = float(np.median(cv2.absdiff(self.gray, before.gray)))
        return max(LEAST_NOISE, 1.4826 * change / np.sqrt(2.0))

    def shows(self, pixels: Float32[np.ndarray, "points 2"]) -> Bool[np.ndarray, " points"]:
        """Whether a window around each pixel shows one layer of cloth."""
        column, row = np.rint(pixels).astype(np.int64).T
        height, width = self.clear.shape
        shown = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        shown[shown] = self.clear[row[shown], column[shown]]
        return shown

    def in_world(
        self, pixels: Float32[np.ndarray, "points 2"], camera: Camera
    ) -> Float[np.ndarray, "points 3"]:
        """Where the cloth is at these pixels [m]."""
        if not len(pixels):
            return np.zeros((0, 3))
        depth = cv2.remap(self.depth, pixels[:, None, 0], pixels[:, None, 1], cv2.INTER_LINEAR)
        aside = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        local = np.column_stack([aside, np.ones(len(pixels))]) * depth.astype(np.float64)
        return local @ camera.world_from_camera[:3, :3].T + camera.position


class _Follower:
    """Follows the points that one camera sees."""

    def __init__(self, camera: Camera, first_number: int) -> None:
        self._camera, self.next_number = camera, first_number
        self._recogniser = Recogniser()
        self.lose_all()

    def lose_all(self) -> None:
        """Begin anew: a picture is missing."""
        self._before: _Picture | None = None
        self._numbers, self._pixels = np.zeros(0, np.int64), np.zeros((0, 2), np.float32)
        self._beside, self._apart_m = np.zeros((0, 0), np.int64), np.zeros((0, 0))

    def follow(self, picture: _Picture, *, choose: bool, look: bool) -> FollowedPoints:
        """The points in the next picture.

        Args:
            picture: the next one.
            choose: add new ones where there are none.
            look: recognise those that were lost.
        """
        if self._before is not None and len(self._pixels):
            there, found = _carried(self._before.gray, picture.gray, self._pixels)
            home, also = _carried(picture.gray, self._before.gray, there)
            came_home = np.linalg.norm(home - self._pixels, axis=1) < HOME_PX
            self._keep(found & also & came_home & picture.shows(there), there)
            self._keep(self._near_each_other(picture), self._pixels)
        unknown = None
        if (choose or look) and self._recogniser.sees_print:
            unknown = self._recognise(picture)
        if choose:
            self._choose(picture, unknown)
        self._before = picture
        positions = picture.in_world(self._pixels, self._camera)
        return FollowedPoints(self._numbers.copy(), positions)

    def _keep(
        self, kept: Bool[np.ndarray, " points"], pixels: Float32[np.ndarray, "points 2"]
    ) -> None:
        self._numbers, self._pixels = self._numbers[kept], pixels[kept]
        self._beside, self._apart_m = self._beside[kept], self._apart_m[kept]

    def _recognise(self, picture: _Picture) -> KeyPoints:
        """Add points that were lost; returns the key points of the picture that are not known."""
        seen = KeyPoints.of(picture.gray, picture.clear)
        numbers = self._recogniser.recognised(seen, picture.in_world(seen.pixels, self._camera))
        lost = (numbers >= 0) & ~np.isin(numbers, self._numbers)
        self._add(numbers[lost], seen.pixels[lost])
        return seen[numbers < 0]

    def _choose(self, picture: _Picture, unknown: KeyPoints | None) -> None:
        """Add points; from now on each has to stay near those that are beside it here."""
        noise = picture.noise_since(self._before)
        if unknown is not None:
            numbers = self._new_numbers(len(unknown))
            positions = picture.in_world(unknown.pixels, self._camera)
            self._recogniser.remember(numbers, unknown, positions)
            if self._recogniser.sees_print:
                self._add(numbers, unknown.pixels)
        spread = ~self._recogniser.knows(self._numbers)
        fresh = _chosen(picture, noise, self._pixels[spread])
        self._add(self._new_numbers(len(fresh)), fresh)
        positions = picture.in_world(self._pixels, self._camera)
        # Key points lie close together: what is around a part of the print the others show.
        spread = np.flatnonzero(~self._recogniser.knows(self._numbers))
        near = min(NEIGHBOURS, max(len(spread) - 1, 0))
        apart, beside = np.zeros((len(positions), 1)), np.zeros((len(positions), 1), np.int64)
        if near:
            apart, place = cKDTree(positions[spread]).query(positions, k=near + 1)
            beside = spread[place]
        # By number, because others will be lost.
        self._beside, self._apart_m = self._numbers[beside[:, 1:]], apart[:, 1:]

    def _new_numbers(self, count: int) -> Int[np.ndarray, " points"]:
        self.next_number += count
        return np.arange(self.next_number - count, self.next_number)

    def _add(
        self, numbers: Int[np.ndarray, " points"], pixels: Float32[np.ndarray, "points 2"]
    ) -> None:
        """Add points that have nobody beside them yet, in the order of their numbers."""
        alone = np.broadcast_to(numbers[:, None], (len(numbers), self._beside.shape[1]))
        together = np.append(self._numbers, numbers)
        order = np.argsort(together)
        self._numbers = together[order]
        self._pixels = np.concatenate([self._pixels, pixels])[order]
        self._beside = np.concatenate([self._beside, alone])[order]
        self._apart_m = np.concatenate([self._apart_m, np.zeros(alone.shape)])[order]

    def _near_each_other(self, picture: _Picture) -> Bool[np.ndarray, " points"]:
        """Whether each point is still near most of those that were beside it and are not lost."""
        if not len(self._numbers):
            return np.zeros(0, dtype=bool)
        positions = picture.in_world(self._pixels, self._camera)
        place = np.minimum(np.searchsorted(self._numbers, self._beside), len(self._numbers) - 1)
        followed = self._numbers[place] == self._beside
        apart = np.linalg.norm(positions[place] - positions[:, None], axis=2)
        too_far = followed & too_far_apart(apart, self._apart_m)
        return too_far.sum(axis=1) <= 0.5 * followed.sum(axis=1)


def _carried(
    before: UInt8[np.ndarray, "height width"],
    after: UInt8[np.ndarray, "height width"],
    pixels: Float32[np.ndarray, "points 2"],
) -> tuple[Float32[np.ndarray, "points 2"], Bool[np.ndarray, " points"]]:
    """Where windows of one picture are in another, and whether they were found."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, pixels[:, None], None, winSize=(WINDOW_PX, WINDOW_PX), maxLevel=3
    )
    return there[:, 0], found[:, 0] == 1


def _chosen(
    picture: _Picture, noise: float, taken: Float32[np.ndarray, "taken 2"]
) -> Float32[np.ndarray, "fresh 2"]:
    """The best pixel of each cell in which there is none yet, where a window tells its place."""
    weakest = _weakest_contrast(picture.gray)
    tells = picture.clear & (weakest > (noise / LARGEST_ERROR_PX) ** 2)
    row, column = np.nonzero(tells)
    if not len(row):
        return np.zeros((0, 2), np.float32)
    cells_across = -(-picture.gray.shape[1] // SPACING_PX)
    cell = row // SPACING_PX * cells_across + column // SPACING_PX
    order = np.lexsort((-weakest[row, column], cell))
    best = order[np.unique(cell[order], return_index=True)[1]]
    over, down = np.rint(taken).astype(np.int64).T // SPACING_PX
    best = best[~np.isin(cell[best], down * cells_across + over)]
    return np.stack([column[best], row[best]], axis=1).astype(np.float32)


def _weakest_contrast(
    gray: UInt8[np.ndarray, "height width"],
) -> Float32[np.ndarray, "height width"]:
    """Squared slopes, summed over the window, in the direction in which they are least.

    The noise of the picture divided by the root of it is how well the window's place can be told
    [pixels] (J. Shi and C. Tomasi, "Good features to track", doi:10.1109/CVPR.1994.323794).
    """
    picture = gray.astype(np.float32)
    # Scharr's weights add up to 32: a slope per pixel.
    across, down = (
        cv2.Scharr(picture, cv2.CV_32F, *axis, scale=1.0 / 32.0) for axis in ((1, 0), (0, 1))
    )
    window = (WINDOW_PX, WINDOW_PX)
    xx, xy, yy = (
        cv2.boxFilter(product, -1, window, normalize=False)
        for product in (across * across, across * down, down * down)
    )
    return 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
