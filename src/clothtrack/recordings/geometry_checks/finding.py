"""What a check of the geometry finds, and what the checks look at."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Recording, Table

RIM_PIXELS = 3
"""A cloth this near to the rim of the picture may go on beyond it."""


@dataclass(frozen=True)
class Finding:
    """Something that the recording says and its pictures contradict.

    Attributes:
        check: which check: "depth unit", "camera pose", "cloth height", "size", "template",
            "first frame", "picker path" or "picker clock".
        measured: what the pictures show, in `unit`.
        expected: what the recording says, or the limit that is passed, in `unit`.
        unit: of both: "m", "deg", "s", or "" for a plain number.
        field: of recording.json, or picker.csv, that is to be corrected first.
        text: the finding in one sentence, with the remedy.
    """

    check: str
    measured: float
    expected: float
    unit: str
    field: str
    text: str


class ObservedFrames:
    """The clouds of a recording, each made once."""

    def __init__(self, recording: Recording) -> None:
        """Nothing is read before it is asked for."""
        self.recording = recording
        self._seen: dict[int, Observation | None] = {}

    def at(self, frame: int) -> Observation | None:
        """What was seen of the cloth in a frame; None where it is not found."""
        if frame not in self._seen:
            try:
                self._seen[frame] = observe(self.recording, self.recording.frames[frame])
            except ClothTrackError:
                self._seen[frame] = None
        return self._seen[frame]


def reaches_rim(observation: Observation) -> bool:
    """Whether the cloth reaches the rim of a picture, so that it may go on beyond it."""
    for camera in observation.cameras:
        pixels, depth = camera.project(observation.points)
        inside = pixels[depth > 0]
        far = (camera.width - 1 - RIM_PIXELS, camera.height - 1 - RIM_PIXELS)
        if len(inside) and ((inside < RIM_PIXELS) | (inside > far)).any(axis=1).mean() > 0.002:
            return True
    return False


def on_table(
    points: Float[np.ndarray, "points 3"], table: Table
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Places of points in the plane of a table, and their heights above it [m]."""
    normal = table.normal / np.linalg.norm(table.normal)
    across = np.eye(3)[np.argmin(np.abs(normal))]
    first = np.cross(across, normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    away = points - table.point
    return np.stack([away @ first, away @ second], axis=1), away @ normal


def power_of_ten(ratio: float) -> float | None:
    """The power of ten, but for 1, that a ratio is within a quarter of; None where it is none."""
    if not ratio > 0:
        return None
    power = round(float(np.log10(ratio)))
    return 10.0**power if power and abs(np.log10(ratio) - power) < NEARLY else None


NEARLY = 0.1
"""How far the logarithm of a ratio may be from a whole number: what is wrong by a factor of ten is
wrong by nothing else."""
