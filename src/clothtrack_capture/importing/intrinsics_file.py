"""JSON files with intrinsics, for sources that do not contain them."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.files.bounds import Bounds
from clothtrack.geometry.camera import rigid_problem
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.source import StereoCalibration

_LARGEST_FILE = 16 * 2**20
_FIELDS = (
    dict.fromkeys(("width", "height"), (int, Bounds(least=1)))
    | dict.fromkeys(("fx", "fy", "fps", "depth_scale"), (float, Bounds(above=0)))
    | dict.fromkeys(("cx", "cy"), (float, Bounds()))
)
"""Type and limits of every number in the file."""


@dataclass(frozen=True, eq=False)
class IntrinsicsFile:
    """The content of the file.

    Attributes:
        depth: intrinsics of the depth pictures.
        color: intrinsics of the color pictures.
        color_from_depth: rigid transform, depth camera to color camera [m].
        fps: pictures per second [1/s], if the file has it.
        depth_unit_m: meters per unit of depth [m], if the file has it.
    """

    depth: Intrinsics
    color: Intrinsics
    color_from_depth: Float[np.ndarray, "4 4"]
    fps: float | None = None
    depth_unit_m: float | None = None

    def calibration(self, unit_m: float, origin: str, *, with_color: bool) -> StereoCalibration:
        """Return the calibration of a source with this depth unit [m] and its origin."""
        color = self.color if with_color else None
        return StereoCalibration(self.depth, color, self.color_from_depth, unit_m, origin)


def read_json(path: Path) -> Any:
    """Return the content of a JSON file of limited size."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise InvalidRecordingError(
                f"{path}: {path.stat().st_size} bytes; such a file has at most {_LARGEST_FILE}"
            )
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InvalidRecordingError(f"{path}: {error.strerror}; check the name") from error
    except (ValueError, RecursionError) as error:
        raise InvalidRecordingError(f"{path}: broken JSON ({error}); correct it") from error


def read_intrinsics(path: Path) -> IntrinsicsFile:
    """Return the intrinsics in a JSON file."""
    content = read_json(path)
    if not isinstance(content, dict):
        raise InvalidRecordingError(f"{path}: not a JSON object; see docs/import.md")
    if "depth" not in content:
        intrinsics = _intrinsics(path, content, "")
        return IntrinsicsFile(
            intrinsics,
            intrinsics,
            np.eye(4),
            _optional(path, content, "fps"),
            _depth_scale(path, content),
        )
    depth = _intrinsics(path, content["depth"], "depth.")
    color = _intrinsics(path, content.get("color", content["depth"]), "color.")
    pose = rigid_matrix(f"{path}: color_from_depth", content.get("color_from_depth", np.eye(4)))
    return IntrinsicsFile(
        depth, color, pose, _optional(path, content, "fps"), _depth_scale(path, content)
    )


def rigid_matrix(what: str, value: Any) -> Float[np.ndarray, "4 4"]:
    """Return a rigid 4 x 4 matrix from its rows."""
    try:
        matrix = np.array(value, dtype=np.float64)
    except (ValueError, TypeError):
        matrix = np.zeros(0)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InvalidRecordingError(f"{what} is not 4 x 4 numbers; write four rows of four")
    if problem := rigid_problem(matrix):
        raise InvalidRecordingError(f"{what} {problem}")
    return matrix


def _intrinsics(path: Path, content: Any, place: str) -> Intrinsics:
    if not isinstance(content, dict):
        raise InvalidRecordingError(f"{path}: {place.rstrip('.')} is not an object")
    matrix = content.get("intrinsic_matrix")
    if isinstance(matrix, list) and len(matrix) == 9:
        content = content | {"fx": matrix[0], "fy": matrix[4], "cx": matrix[6], "cy": matrix[7]}
    numbers = {
        name: _number(f"{path}: {place}", content, name)
        for name in ("width", "height", "fx", "fy", "cx", "cy")
    }
    coefficients = content.get("distortion", [])
    if not isinstance(coefficients, list) or not all(
        isinstance(value, int | float) for value in coefficients
    ):
        raise InvalidRecordingError(
            f"{path}: {place}distortion is {str(coefficients)[:40]!r}; give a list of numbers such "
            "as [0, 0, 0, 0, 0], or leave it out"
        )
    model = content.get("model", "brown")
    if model not in ("brown", "fisheye"):
        raise InvalidRecordingError(
            f'{path}: {place}model is {model!r}; write "brown" or "fisheye"'
        )
    try:
        return Intrinsics(
            **numbers, distortion=tuple(map(float, coefficients)), fisheye=model == "fisheye"
        )
    except (InvalidRecordingError, OverflowError) as error:
        raise InvalidRecordingError(f"{path}: {place}{error}") from error


def _number(place: str, content: dict[str, Any], name: str) -> Any:
    value, (kind, limit) = content.get(name), _FIELDS[name]
    if isinstance(value, bool) or not isinstance(value, (int, kind)):
        whole = "whole " if kind is int else ""
        raise InvalidRecordingError(f"{place}{name} is {value!r:.40}; write a {whole}number")
    if abs(value) > sys.float_info.max or not limit.holds(value):
        raise InvalidRecordingError(f"{place}{name} is {value!r:.40}; {limit}")
    return kind(value)


def _optional(path: Path, content: dict[str, Any], name: str) -> float | None:
    return None if content.get(name) is None else _number(f"{path}: ", content, name)


def _depth_scale(path: Path, content: dict[str, Any]) -> float | None:
    """Return Open3D's `depth_scale`: units per meter."""
    scale = _optional(path, content, "depth_scale")
    return None if scale is None else 1.0 / scale
