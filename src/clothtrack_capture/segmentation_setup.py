"""Cloth segmentation: masks of every frame, learned from one click or box."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, UInt8

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.colors import CORE, NAMED_COLORS, named_set, votes_of, with_shades
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import ColorSegmenter, Segmenter, default_segmenter
from clothtrack_capture.amendment import set_masks

Point = tuple[int, int]
Box = tuple[int, int, int, int]

_REMEMBERED = 64
_NAMED_SHARE = 0.85


class SegmentationSetup:
    """The masks of one camera's pictures, and the click or box that they come from.

    The class is thread-safe.
    """

    def __init__(self, recording: Recording, camera: Camera) -> None:
        """Start with the cloth information that the recording already has, if any."""
        self.recording, self.camera = recording, camera
        self.frames = tuple(
            frame
            for frame in recording.frames
            if camera.name in frame.color and camera.name in frame.depth
        )
        if not self.frames:
            raise InvalidRecordingError(
                f"{recording.folder}: camera {camera.name!r} has no frame with both color and "
                "depth to choose a cloth in; give mask/ files"
            )
        self._lock = threading.RLock()
        self._by_index = {frame.index: frame for frame in self.frames}
        self._learned: Segmenter | None = None
        self._choice: Mapping[str, object] = {}
        self._masks = lru_cache(maxsize=_REMEMBERED)(self._mask)

    @property
    def chosen(self) -> bool:
        """Whether a click or box was given."""
        return self._learned is not None

    def choose_click(self, frame: int, point: Point) -> None:
        """Learn the cloth from a click (column, row) on it in a frame."""
        learned = ColorSegmenter.from_click(self.picture(frame), *point)
        self._learn(learned, frame, {"click": [*point]})

    def choose_box(self, frame: int, box: Box) -> None:
        """Learn the cloth from a box (left, top, right, bottom) around it in a frame."""
        learned = ColorSegmenter.from_box(self.picture(frame), box)
        self._learn(learned, frame, {"box": [*box]})

    def picture(self, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """Return the color picture of a frame, red first."""
        return read_color(self._frame(frame).color[self.camera.name])

    def mask(self, frame: int) -> Bool[np.ndarray, "height width"] | None:
        """Return the cloth mask of a frame by the present choice; None if it is not known."""
        with self._lock:
            return self._masks(frame)

    def keep(self) -> Recording:
        """Return the recording with the masks of all frames, written unless it is in memory."""
        with self._lock:
            if not self.chosen:
                raise InvalidConfigError("nothing is chosen yet; click on the cloth, or give a box")
            return set_masks(
                self.recording,
                self.camera.name,
                lambda frame: self._mask(frame.index) if frame.index in self._by_index else None,
                color=self._color_name(),
                provenance={"masks_from": {"camera": self.camera.name, **self._choice}},
            )

    def _learn(
        self, segmenter: ColorSegmenter, index: int, choice: Mapping[str, Sequence[int]]
    ) -> None:
        color = self.picture(index)
        cloth = self._found_by(segmenter, self._frame(index))
        if not (cloth & (votes_of(color, segmenter.members) == CORE)).any():
            how, where = next(iter(choice.items()))
            raise InvalidConfigError(
                f"{self.recording.folder}: frame {index}: nothing that looks like the {how} "
                f"({', '.join(map(str, where))}) is cloth; click on the cloth, or give a box "
                "around it"
            )
        # One picture shows the cloth in one light. Later folds turn it towards or away from the
        # lamp.
        shaded = replace(segmenter, members=with_shades(segmenter.members, color, cloth))
        with self._lock:
            self._learned, self._choice = shaded, {"frame": index, **choice}
            self._masks.cache_clear()

    def _found_by(self, find: Segmenter, frame: Frame) -> Bool[np.ndarray, "height width"]:
        camera = self.camera
        depth = read_depth(frame.depth[camera.name], self.recording.depth_units_m[camera.name])
        return find(self.picture(frame.index), depth, camera, self.recording.table)

    def _frame(self, index: int) -> Frame:
        if index not in self._by_index:
            raise InvalidConfigError(
                f"there is no color picture of frame {index}; choose one from "
                f"{self.frames[0].index} to {self.frames[-1].index}"
            )
        return self._by_index[index]

    def _mask(self, index: int) -> Bool[np.ndarray, "height width"] | None:
        frame, camera = self._frame(index), self.camera
        try:
            find = self._learned or default_segmenter(self.recording, frame, camera)
            return self._found_by(find, frame)
        except InvalidRecordingError:
            if self._learned is None:
                return None
            raise

    def _color_name(self) -> str | None:
        """Return the color name that fits most of the first frame's cloth and little else."""
        mask = self._mask(self.frames[0].index)
        if mask is None or not mask.any():
            return None
        color = self.picture(self.frames[0].index)
        for name in NAMED_COLORS:
            named = votes_of(color, named_set(name)) == CORE
            if named[mask].mean() > _NAMED_SHARE and mask[named].mean() > _NAMED_SHARE:
                return name
        return None
