"""Views of a cloth moved by a hand: its visible points, and how much the hand hides."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import flying_pixels
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Recording, Table
from clothtrack.recordings.segmentation import default_segmenter, height_picture

SNAP_M = 0.015
"""Largest distance at which a click next to the cloth still counts as on the cloth [m]."""

_TOUCH_PIXELS = 2.5
_TOUCH_FRAMES = 10
_HAND_HEIGHT_M = 0.02
_RIM = np.ones((5, 5), np.uint8)
_REMEMBERED = 256


@dataclass(frozen=True)
class Click:
    """A click on a frame: column and row [pixels]."""

    frame: int
    column: int
    row: int


@dataclass(frozen=True, eq=False)
class _ClothView:
    """The cloth as seen in one frame.

    Attributes:
        points: measured cloth points [m], world.
        pixels: column and row of each point.
        inner: points away from the mask's rim, where depth mixes cloth and hand.
        hand_share: share of the picture that shows something high other than the cloth.
    """

    points: Float[np.ndarray, "points 3"]
    pixels: Int[np.ndarray, "points 2"]
    inner: Bool[np.ndarray, " points"]
    hand_share: float


class ClothViews:
    """The frames of a recording as seen by one camera; the latest ones are cached."""

    def __init__(self, recording: Recording, camera: Camera) -> None:
        """Check that the cloth in the recording can be told apart from a hand."""
        self.recording, self.camera = recording, camera
        self.table = _required_table(recording, camera)
        self.of = lru_cache(maxsize=_REMEMBERED)(self._seen_in)

    def require(self, click: Click) -> None:
        """Refuse a click on a missing frame or outside the picture."""
        self._require_frame(click.frame)
        width, height = self.camera.width, self.camera.height
        if not (0 <= click.column < width and 0 <= click.row < height):
            raise InvalidConfigError(
                f"the click ({click.column}, {click.row}) is outside the picture of "
                f"{width} x {height} pixels; give column and row, counted from 0"
            )

    def picture(self, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """Return the color picture of a frame, red first."""
        self._require_frame(frame)
        return read_color(self.recording.frames[frame].color[self.camera.name])

    def mask(self, frame: int) -> Bool[np.ndarray, "height width"]:
        """Return the mask of the cloth in a frame."""
        self._require_frame(frame)
        return self._depth_and_mask(frame)[1]

    def cloth_at(self, click: Click, frames: Iterable[int]) -> Float[np.ndarray, " 3"] | None:
        """Return the cloth at a clicked pixel [m], world, from the first frames that show it.

        If no frame shows cloth at the pixel, return the nearest cloth within `SNAP_M` of it, or
        None if there is none.
        """
        touched, snapped = [], []
        for index in frames:
            view = self.of(index)
            if not len(view.points):
                continue
            aside = np.linalg.norm(view.pixels - (click.column, click.row), axis=1)
            near, nearest = np.flatnonzero(aside <= _TOUCH_PIXELS), int(np.argmin(aside))
            depth = float(self.camera.project(view.points[nearest][None])[1][0])
            if len(near):
                touched.append(np.median(view.points[near], axis=0))
            elif aside[nearest] <= SNAP_M * self.camera.fx / depth:
                snapped.append(view.points[nearest])
            if len(touched) == _TOUCH_FRAMES:
                break
        chosen = touched or snapped[:_TOUCH_FRAMES]
        return np.median(chosen, axis=0) if chosen else None

    def table_at(self, click: Click) -> Float[np.ndarray, " 3"]:
        """Return the point on the table at a click's pixel [m], world."""
        camera, normal = self.camera, self.table.normal
        ray = camera.world_from_camera[:3, :3] @ np.array(
            [(click.column - camera.cx) / camera.fx, (click.row - camera.cy) / camera.fy, 1.0]
        )
        above = float(self.table.heights(camera.position[None])[0])
        return camera.position - above / float(ray @ normal) * ray

    def _seen_in(self, index: int) -> _ClothView:
        depth, mask = self._depth_and_mask(index)
        shown = mask & (depth > 0) & ~flying_pixels(depth, self.camera.fx)
        rows, columns = np.nonzero(shown)
        around = cv2.dilate(mask.view(np.uint8), _RIM) > 0
        high = height_picture(depth, self.camera, self.table) > _HAND_HEIGHT_M
        return _ClothView(
            self.camera.back_project(depth, shown),
            np.stack([columns, rows], axis=1).astype(np.int32),
            (cv2.erode(mask.view(np.uint8), _RIM) > 0)[shown],
            float(((depth > 0) & high & ~around).mean()),
        )

    def _depth_and_mask(
        self, index: int
    ) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
        recording, camera = self.recording, self.camera
        frame = recording.frames[index]
        depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
        if camera.name not in frame.mask and recording.cloth.color is None:
            # The fallback segments by height alone and would take the hand for cloth.
            return depth, np.zeros(depth.shape, dtype=bool)
        find = default_segmenter(recording, frame, camera)
        color = read_color(frame.color[camera.name])
        return depth, find(color, depth, camera, recording.table)

    def _require_frame(self, frame: int) -> None:
        last = len(self.recording.frames) - 1
        if not 0 <= frame <= last:
            raise InvalidConfigError(
                f"{self.recording.folder}: there is no frame {frame}; choose one from 0 to {last}"
            )


def _required_table(recording: Recording, camera: Camera) -> Table:
    """Return the recording's table after checking that clicks have all the data they need."""
    folder = recording.folder
    if recording.table is None:
        raise InvalidRecordingError(
            f"{folder}: without a table nobody knows how high the cloth is lifted; run clothtrack "
            "calibrate-camera first"
        )
    for frame in recording.frames:
        if camera.name not in frame.color or camera.name not in frame.depth:
            raise InvalidRecordingError(
                f"{folder}: frame {frame.index} has no color or no depth from camera "
                f"{camera.name!r}; clicks need both in every frame"
            )
    masked = any(camera.name in frame.mask for frame in recording.frames)
    if not masked and recording.cloth.color is None:
        raise InvalidRecordingError(
            f"{folder}: nothing tells the cloth from the hand: there are no masks and no "
            "cloth.color, and both stand out of the table; run clothtrack segment first"
        )
    return recording.table
