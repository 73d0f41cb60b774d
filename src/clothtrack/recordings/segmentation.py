"""Segmentation of the cloth by color, by height above the table, or from masks on disk."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack._shown import short_repr
from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.colors import (
    CORE,
    LOOSE,
    NAMED_COLORS,
    learned_set,
    named_set,
    votes_of,
)
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.recording import Frame, Recording, Table

_RAISED_M = 0.006
"""A color that may be cloth counts from this height above the table [m]."""
_TOOL_GAP_M = 0.015
"""Pixels nearer to the camera than the cloth around by more than this [m] are tool, not print."""
WIDEST_SHARE = 0.6
"""A larger share of the picture is never cloth alone: the background has its color, too."""
LOWEST_M = 0.004
"""Pixels lower than this above the table [m] are table; depth cameras have less noise."""
_CLICK_TOLERANCE = 9.0
"""Largest difference of a patch's color from the clicked one in a and b of CIE Lab.

A unit is about a visible difference; L counts half.
"""
_BOX_ROUNDS = 2
"""Number of times that the colors of a box are learned again from the resulting mask."""
_SMALLEST_PART = 0.02
"""A part of the mask below this share of the largest one is not cloth that a tool cut off."""

_WIDEST_TOOL = 0.1
"""Largest distance of such a part from the rest: a tool's width, as a share of the picture's."""

_OPENING = np.ones((3, 3), np.uint8)
_CLOSING = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (9, 9))


@runtime_checkable
class Segmenter(Protocol):
    """A function that finds the cloth in a picture, for example a network."""

    def __call__(
        self,
        color: UInt8[np.ndarray, "height width 3"] | None,
        depth_m: Float[np.ndarray, "height width"],
        camera: Camera,
        table: Table | None,
    ) -> Bool[np.ndarray, "height width"]:
        """Return the mask of the cloth.

        Args:
            color: color picture, red first, when the frame has one.
            depth_m: depth [m], 0 where nothing was measured.
            camera: the camera of both.
            table: the table, when there is one.
        """
        ...


@dataclass(frozen=True, eq=False)
class ColorSegmenter:
    """A segmenter by color, with the height above the table as a second vote.

    Make one with `from_name`, `from_click` or `from_box`.

    Attributes:
        members: per color (five bits per channel) whether it is cloth: 2 surely, 1 perhaps, 0 no.
    """

    members: UInt8[np.ndarray, "32 32 32"]

    __repr__ = short_repr

    @classmethod
    def from_name(cls, name: str) -> "ColorSegmenter":
        """Return the segmenter of a color name such as "blue".

        Raises:
            InvalidConfigError: the name is unknown.
        """
        if name.lower() not in NAMED_COLORS:
            raise InvalidConfigError(
                f"the cloth's color is {name!r}; known names: {', '.join(NAMED_COLORS)}"
            )
        return cls(named_set(name))

    @classmethod
    def from_box(
        cls, color: UInt8[np.ndarray, "height width 3"], box: tuple[int, int, int, int]
    ) -> "ColorSegmenter":
        """Return a segmenter learned from a box around the cloth in one picture.

        Colors are learned from the middle of the box against the outside of the box, then again
        from the resulting mask.

        Args:
            color: color picture, red first.
            box: first column, first row, and the column and row after the last [pixels].

        Raises:
            InvalidConfigError: the box is empty or leaves the picture, or nothing in it differs
                from the outside.
        """
        left, top, right, bottom = box
        height, width = color.shape[:2]
        if not (0 <= left < right <= width and 0 <= top < bottom <= height):
            raise InvalidConfigError(
                f"the box {box} is not inside the picture of {width} x {height} pixels; "
                "give left, top, right, bottom"
            )
        # The middle of the box is cloth; arms and background are at its rim.
        rim = (right - left) // 5, (bottom - top) // 5
        middle = np.zeros((height, width), dtype=bool)
        middle[top + rim[1] : bottom - rim[1], left + rim[0] : right - rim[0]] = True
        outside = np.ones((height, width), dtype=bool)
        outside[top:bottom, left:right] = False
        return cls._learn(color, middle, outside, rounds=_BOX_ROUNDS)

    @classmethod
    def from_click(
        cls, color: UInt8[np.ndarray, "height width 3"], column: int, row: int
    ) -> "ColorSegmenter":
        """Return a segmenter learned from one click on a plain cloth; a printed one needs a box.

        The uniform patch around the click is learned, and everything that looks like it.

        Args:
            color: color picture, red first.
            column: column of the click [pixels].
            row: row of the click [pixels].

        Raises:
            InvalidConfigError: the click is outside the picture.
        """
        height, width = color.shape[:2]
        if not (0 <= column < width and 0 <= row < height):
            raise InvalidConfigError(
                f"the click ({column}, {row}) is outside the picture of {width} x {height} pixels; "
                "give column and row, counted from 0"
            )
        soft = cv2.GaussianBlur(color, (0, 0), 3.0)
        lab = cv2.cvtColor(soft, cv2.COLOR_RGB2LAB)
        region = np.zeros((height + 2, width + 2), np.uint8)
        # OpenCV stretches L (0 to 100) over 0 to 255: 5 of its units are 2 of Lab.
        reach = (_CLICK_TOLERANCE * 2 * 2.55, _CLICK_TOLERANCE, _CLICK_TOLERANCE)
        flags = 4 | (255 << 8) | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE
        cv2.floodFill(lab, region, (column, row), (0, 0, 0), reach, reach, flags)
        patch = region[1:-1, 1:-1] > 0
        beyond = cv2.dilate(patch.astype(np.uint8), np.ones((9, 9), np.uint8)) == 0
        return cls._learn(color, patch, beyond, rounds=1)

    @classmethod
    def _learn(
        cls,
        color: UInt8[np.ndarray, "height width 3"],
        cloth: Bool[np.ndarray, "height width"],
        other: Bool[np.ndarray, "height width"],
        *,
        rounds: int,
    ) -> "ColorSegmenter":
        members = learned_set(color, cloth, other)
        for _ in range(rounds):
            mask = main_components(_closed(_opened(votes_of(color, members) == CORE)))
            if not mask.any():
                break
            members = learned_set(color, mask, ~mask)
        if not (members == CORE).any():
            raise InvalidConfigError(
                "no color of the cloth differs from the rest of the picture; "
                "give masks, or a table so that height can decide"
            )
        return cls(members)

    def __call__(
        self,
        color: UInt8[np.ndarray, "height width 3"] | None,
        depth_m: Float[np.ndarray, "height width"],
        camera: Camera,
        table: Table | None,
    ) -> Bool[np.ndarray, "height width"]:
        """Return the mask of the cloth: its largest connected part and parts nearly as large.

        Raises:
            InvalidRecordingError: there is no color picture, or the background has the cloth's
                colors and there is no table to tell them apart.
        """
        if color is None:
            raise InvalidRecordingError(
                f"camera {camera.name!r}: there is no color picture to find the cloth's color "
                "in; add color/ or mask/ files"
            )
        votes = votes_of(color, self.members)
        # Pixels outside of this window have none of the colors and are never cloth.
        window = bounds_of(votes, margin=_CLOSING.shape[0])
        mask = np.zeros(votes.shape, dtype=bool)
        accepted = self._accepted(votes, depth_m, camera, table, window)
        closed = _closed(accepted)
        mask[window] = main_components(self._without_tool(closed, accepted, depth_m[window]))
        return mask

    def _accepted(
        self,
        votes: UInt8[np.ndarray, "height width"],
        depth_m: Float[np.ndarray, "height width"],
        camera: Camera,
        table: Table | None,
        window: tuple[slice, slice],
    ) -> Bool[np.ndarray, "window_height window_width"]:
        """Return which pixels of a window, which holds all votes, are cloth by color and height."""
        votes, whole = votes[window], votes.size
        accepted = votes == CORE
        measured = depth_m[window] > 0
        if table is None:
            near_core = cv2.dilate(accepted.view(np.uint8), np.ones((5, 5), np.uint8)) > 0
            accepted |= near_core & (votes == LOOSE)
            heights = None
        else:
            heights = height_picture(depth_m, camera, table, window=window)
            accepted |= (votes == LOOSE) & measured & (heights > _RAISED_M)
            accepted &= ~(measured & (heights < -0.03))
        share = np.count_nonzero(accepted) / whole
        if share > WIDEST_SHARE:
            if heights is None:
                raise InvalidRecordingError(
                    f"camera {camera.name!r}: the cloth's colors cover {100 * share:.0f} % of the "
                    f"picture (at most {100 * WIDEST_SHARE:.0f} %), the background has them "
                    "too; give mask/ files, or the table so that height can decide"
                )
            accepted &= measured & (heights > _RAISED_M)
        return _opened(accepted)

    def _without_tool(
        self,
        closed: Bool[np.ndarray, "height width"],
        colored: Bool[np.ndarray, "height width"],
        depth_m: Float[np.ndarray, "height width"],
    ) -> Bool[np.ndarray, "height width"]:
        # Gaps in the color are prints, shine and the tool. A print lies at the depth of the
        # cloth around it, the tool above.
        window = bounds_of(closed)
        whole, closed, colored, depth_m = (closed, closed[window], colored[window], depth_m[window])
        doubtful = closed & ~colored & (depth_m > 0)
        weight = (colored & (depth_m > 0)).astype(np.float32)
        size = (21, 21)
        total = cv2.boxFilter(weight, -1, size, normalize=False)
        around = cv2.boxFilter(weight * depth_m.astype(np.float32), -1, size, normalize=False)
        nearer = depth_m * total < around - _TOOL_GAP_M * total
        whole[window] &= ~(doubtful & (nearer | (total == 0)))
        return whole


@dataclass(frozen=True)
class HeightSegmenter:
    """A segmenter by height, for plain tables with nothing but the cloth on them.

    The flattest parts of a thin cloth are lost, because they are lower than the noise of depth.
    """

    def __call__(
        self,
        color: UInt8[np.ndarray, "height width 3"] | None,  # noqa: ARG002
        depth_m: Float[np.ndarray, "height width"],
        camera: Camera,
        table: Table | None,
    ) -> Bool[np.ndarray, "height width"]:
        """Return the mask of the cloth: the largest raised part and parts nearly as large."""
        if table is None:
            raise InvalidRecordingError(
                f"camera {camera.name!r}: no height without a table; add the field table, "
                "cloth.color or mask/ files"
            )
        smooth = cv2.medianBlur(depth_m.astype(np.float32), 3)
        raised = (smooth > 0) & (height_picture(smooth, camera, table) > LOWEST_M)
        return main_components(_closed(_opened(raised)) & (depth_m > 0))


@dataclass(frozen=True)
class MaskFolder:
    """A segmenter by given masks: one mask, or its file, per camera name."""

    files: Mapping[str, Path | Bool[np.ndarray, "height width"]]

    def __call__(
        self,
        color: UInt8[np.ndarray, "height width 3"] | None,  # noqa: ARG002
        depth_m: Float[np.ndarray, "height width"],
        camera: Camera,
        table: Table | None,  # noqa: ARG002
    ) -> Bool[np.ndarray, "height width"]:
        """Return the mask as it stands in the file."""
        if camera.name not in self.files:
            raise InvalidRecordingError(f"camera {camera.name!r} has no mask; add its file")
        file = self.files[camera.name]
        mask, path = read_mask(file), file if isinstance(file, Path) else camera.name
        if mask.shape != depth_m.shape:
            raise InvalidRecordingError(
                f"{path}: the mask has {mask.shape[1]} x {mask.shape[0]} pixels and the depth "
                f"{depth_m.shape[1]} x {depth_m.shape[0]}; write masks of the same size"
            )
        if not mask.any():
            raise InvalidRecordingError(
                f"{path}: the mask is empty; paint the cloth white or delete the file"
            )
        return mask


def default_segmenter(recording: Recording, frame: Frame, camera: Camera) -> Segmenter:
    """Return the default segmenter: by masks, else by the color hint, else by height."""
    if camera.name in frame.mask:
        return MaskFolder(frame.mask)
    if recording.cloth.color is not None and camera.name in frame.color:
        return ColorSegmenter.from_name(recording.cloth.color)
    if recording.table is not None:
        return HeightSegmenter()
    raise InvalidRecordingError(
        f"{recording.folder}: nothing tells the cloth from the rest in frame {frame.index}, camera "
        f"{camera.name!r}; add mask/ files, or cloth.color (with color/ files), or the table"
    )


def cloth_found_by(
    find: Segmenter,
    recording: Recording,
    frame: Frame,
    camera: Camera,
    *,
    color: UInt8[np.ndarray, "height width 3"] | None,
    depth_m: Float[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Return the mask that a segmenter gives for a frame, checked because it may be anybody's."""
    mask = np.ascontiguousarray(find(color, depth_m, camera, recording.table))
    if mask.shape != depth_m.shape or mask.dtype != bool:
        raise InvalidConfigError(
            f"{recording.folder}: frame {frame.index}: the segmenter gave {mask.dtype} of shape "
            f"{mask.shape} for camera {camera.name!r}; return bool of shape {depth_m.shape}, True "
            "on the cloth"
        )
    return mask


def height_picture(
    depth_m: Float[np.ndarray, "height width"],
    camera: Camera,
    table: Table,
    *,
    window: tuple[slice, slice] = (slice(None), slice(None)),
) -> Float[np.ndarray, "window_height window_width"]:
    """Return the height above the table [m] of each pixel of a window; undefined without depth."""
    heights, offset_m = height_per_depth(camera, table, window=window)
    heights *= depth_m[window]
    heights += offset_m
    return heights


def height_per_depth(
    camera: Camera,
    table: Table,
    *,
    window: tuple[slice, slice] = (slice(None), slice(None)),
) -> tuple[Float[np.ndarray, "window_height window_width"], np.float32]:
    """Return the slope and offset of height above the table over depth, per pixel of a window.

    The height is the slope times the depth plus the offset [m], which is the camera's own height.
    """
    normal = camera.world_from_camera[:3, :3].T @ table.normal
    rows = (np.arange(camera.height)[window[0]] - camera.cy) / camera.fy * normal[1] + normal[2]
    columns = (np.arange(camera.width)[window[1]] - camera.cx) / camera.fx * normal[0]
    slopes = np.add.outer(rows.astype(np.float32), columns.astype(np.float32))
    return slopes, np.float32((camera.position - table.point) @ table.normal)


def main_components(
    mask: Bool[np.ndarray, "height width"], share: float = 0.25
) -> Bool[np.ndarray, "height width"]:
    """Return the largest part of a mask, those nearly as large, and what a tool cut off them.

    Parts of at least `share` of the largest one's area are kept, and smaller ones beside them, such
    as a sleeve beyond the tool. A small part farther away is another object of the same color.
    """
    kept = np.zeros_like(mask)
    window = bounds_of(mask)
    # OpenCV's own statistics of the parts cost four times as much as the parts.
    _, labels = cv2.connectedComponents(mask[window].view(np.uint8), connectivity=8)
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    large = (areas > 0) & (areas >= share * areas.max())
    small = (areas >= _SMALLEST_PART * areas.max()) & ~large
    if small.any():
        away = cv2.distanceTransform((~large[labels]).view(np.uint8), cv2.DIST_L2, 3)
        for part in np.flatnonzero(small):
            large[part] = away[labels == part].min() < _WIDEST_TOOL * mask.shape[1]
    kept[window] = large.take(labels)
    return kept


def bounds_of(
    marks: Bool[np.ndarray, "height width"] | UInt8[np.ndarray, "height width"], *, margin: int = 0
) -> tuple[slice, slice]:
    """Return the smallest window that holds every nonzero pixel, and a margin [pixels] around.

    It has at least one pixel.
    """
    column, row, width, height = cv2.boundingRect(marks.view(np.uint8))
    rows = slice(max(row - margin, 0), row + max(height, 1) + margin)
    return rows, slice(max(column - margin, 0), column + max(width, 1) + margin)


def _opened(mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    return cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_OPEN, _OPENING).view(bool)


def _closed(mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    return cv2.morphologyEx(mask.view(np.uint8), cv2.MORPH_CLOSE, _CLOSING).view(bool)
