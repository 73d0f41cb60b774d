"""The findings of the geometry checks, and the data that the checks use."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.recordings.geometry_checks.small_pictures import PictureReducer, SmallPictures
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Frame, Recording, Table

_RIM_PIXELS = 3
"""A cloth this near to the rim of the picture may go on beyond it."""


@dataclass(frozen=True)
class Finding:
    """Something that the recording says and its pictures contradict.

    Attributes:
        kind: what is wrong, a stable name for programs, such as "camera_pose" or "color_shift";
            docs/data_format.md lists all.
        limit: what the recording says, or the limit that is exceeded, in `unit`.
        unit: of both: "m", "deg", "s", "px", or "" for a plain number.
        field: of recording.json, or the file, that is to be corrected first.
        text: the finding in one sentence, with the remedy.
        severity: "doubt" if a trajectory tracked from this recording must not be trusted; "note" if
            it loses a little accuracy.
    """

    kind: str
    measured: float
    limit: float
    unit: str
    field: str
    text: str
    severity: Literal["doubt", "note"] = "doubt"


class ObservedFrames:
    """The clouds and reduced pictures of a recording, each computed once."""

    def __init__(
        self,
        recording: Recording,
        cloud: Callable[[Frame], Observation] | None = None,
        reducer: PictureReducer | None = None,
    ) -> None:
        """Read nothing yet."""
        self._recording = recording
        self._cloud = cloud or partial(observe, recording)
        self._reducer = reducer or PictureReducer(recording)
        self._seen: dict[int, Observation | None] = {}

    def at(self, frame: int) -> Observation | None:
        """Return the observation of the cloth in a frame; None if it is not found."""
        if frame not in self._seen:
            try:
                self._seen[frame] = self._cloud(self._recording.frames[frame])
            except ClothTrackError:
                self._seen[frame] = None
        return self._seen[frame]

    @cached_property
    def small(self) -> SmallPictures | None:
        """Reduced pictures of one camera; None if there is no readable depth."""
        return self._reducer.pictures()


def reaches_rim(observation: Observation) -> bool:
    """Return whether the cloth reaches the rim of a picture, so that it may go on beyond it."""
    for camera in observation.cameras:
        pixels, depth = camera.project(observation.points)
        inside = pixels[depth > 0]
        far = (camera.width - 1 - _RIM_PIXELS, camera.height - 1 - _RIM_PIXELS)
        if len(inside) and ((inside < _RIM_PIXELS) | (inside > far)).any(axis=1).mean() > 0.002:
            return True
    return False


def on_table(
    points: Float[np.ndarray, "points 3"], table: Table
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Return the places of points in the plane of a table, and their heights above it [m]."""
    normal = table.normal / np.linalg.norm(table.normal)
    across = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(across, normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    away = points - table.point
    return np.stack([away @ first, away @ second], axis=1), away @ normal


def unit_factor(ratio: float) -> float | None:
    """Return the factor between units, other than 1, that a ratio is within a quarter of."""
    if not ratio > 0:
        return None
    factor = min((10.0 ** round(np.log10(ratio)), *_BETWEEN_UNITS), key=lambda f: _apart(ratio, f))
    return factor if factor != 1 and _apart(ratio, factor) < _NEARLY else None


def _apart(ratio: float, factor: float) -> float:
    return float(abs(np.log10(ratio / factor)))


_BETWEEN_UNITS = (4.0, 0.25)
"""Ratios of units of depth cameras, a quarter of a millimeter and a millimeter, beside the powers
of ten."""

_NEARLY = 0.1
"""Largest distance of the logarithm of a ratio from that of a factor; a value that is in another
unit is wrong by nothing else."""
