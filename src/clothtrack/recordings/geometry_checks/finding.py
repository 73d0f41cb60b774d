"""The findings of the geometry checks, and the data that the checks use."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures, small_pictures
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Frame, Recording, Table

Value = TypeVar("Value")

Measured = dict[str, Any]
"""A value `measured`, and the words of its text; where its limit is not that of the check, `limit`,
which is then exceeded."""

_RIM_PIXELS = 3
"""A cloth this near to the rim of the picture may go on beyond it."""


@dataclass(frozen=True)
class Finding:
    """Something that the recording says and its pictures contradict.

    Attributes:
        kind: what is wrong, a stable name for programs, such as "camera_pose" or "picker_clock";
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
    """The clouds and reduced pictures of a recording, and what is measured in them, once."""

    def __init__(
        self,
        recording: Recording,
        cloud: Callable[[Frame], Observation] | None = None,
    ) -> None:
        """Read nothing yet."""
        self.recording = recording
        self._cloud = cloud or partial(observe, recording)
        self._seen: dict[int, Observation | None] = {}
        self._known: dict[Callable[..., Any], Any] = {}

    def at(self, frame: int) -> Observation | None:
        """Return the observation of the cloth in a frame; None if it is not found."""
        if frame not in self._seen:
            try:
                self._seen[frame] = self._cloud(self.recording.frames[frame])
            except ClothTrackError:
                self._seen[frame] = None
        return self._seen[frame]

    def once(self, measure: Callable[["ObservedFrames"], Value]) -> Value:
        """Return what several checks measure, computed once."""
        if measure not in self._known:
            self._known[measure] = measure(self)
        return self._known[measure]

    @cached_property
    def small(self) -> SmallPictures | None:
        """Reduced pictures of one camera; None if there is no readable depth."""
        return small_pictures(self.recording)

    @property
    def table(self) -> Table:
        """The table, for checks that need one."""
        assert self.recording.table is not None
        return self.recording.table

    @property
    def template(self) -> ClothMesh:
        """The template, for checks that need one."""
        assert self.recording.cloth.template is not None
        return self.recording.cloth.template

    @property
    def first(self) -> Observation:
        """The cloth of the first frame, for checks that need it."""
        seen = self.at(0)
        assert seen is not None
        return seen

    @property
    def pictures(self) -> SmallPictures:
        """The reduced pictures, for checks that need them."""
        assert self.small is not None
        return self.small


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
    """Return the factor between units, other than 1, that a ratio is within a quarter of.

    Beside the powers of ten, depth cameras have units of a quarter of a millimeter.
    """
    if not ratio > 0:
        return None
    apart = {
        factor: abs(np.log10(ratio / factor))
        for factor in (10.0 ** round(np.log10(ratio)), 4, 0.25)
    }
    factor = min(apart, key=lambda each: apart[each])
    return float(factor) if factor != 1 and apart[factor] < 0.1 else None
