"""A JSON file with the intrinsics, for sources that do not carry them."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import rigid_problem
from clothtrack.importing.intrinsics import Intrinsics

_LARGEST_FILE = 16 * 2**20


@dataclass(frozen=True, eq=False)
class IntrinsicsFile:
    """What the file says.

    Attributes:
        depth: intrinsics of the depth pictures.
        color: intrinsics of the colour pictures.
        color_from_depth: rigid transform, depth camera to colour camera [m].
        fps: pictures per second [1/s], when the file says.
        depth_unit_m: metres per unit of depth [m], when the file says.
    """

    depth: Intrinsics
    color: Intrinsics
    color_from_depth: Float[np.ndarray, "4 4"]
    fps: float | None = None
    depth_unit_m: float | None = None


def read_json(path: Path) -> Any:
    """A JSON file of reasonable size.

    Raises:
        InvalidRecordingError: it is missing, too large or no JSON.
    """
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
    """The intrinsics in a JSON file.

    Either one set for both pictures, which then are registered (`width`, `height` and `fx`, `fy`,
    `cx`, `cy`; or Open3D's `intrinsic_matrix`, nine numbers by columns), or `depth`, `color` and
    `color_from_depth`. A set may have `distortion` and `model` ("brown" or "fisheye").

    Raises:
        InvalidRecordingError: a field is missing or is not what it should be.
    """
    content = read_json(path)
    if not isinstance(content, dict):
        raise InvalidRecordingError(f"{path}: not a JSON object; see docs/import.md")
    if "depth" not in content:
        intrinsics = _intrinsics(path, content, "")
        return IntrinsicsFile(
            intrinsics,
            intrinsics,
            np.eye(4),
            _positive(path, content, "fps"),
            _depth_scale(path, content),
        )
    depth = _intrinsics(path, content["depth"], "depth.")
    color = _intrinsics(path, content.get("color", content["depth"]), "color.")
    pose = rigid_matrix(f"{path}: color_from_depth", content.get("color_from_depth", np.eye(4)))
    return IntrinsicsFile(
        depth, color, pose, _positive(path, content, "fps"), _depth_scale(path, content)
    )


def rigid_matrix(what: str, value: Any) -> Float[np.ndarray, "4 4"]:
    """A rigid 4 x 4 matrix, by rows.

    Args:
        what: file and field, for the error.
        value: nested lists.

    Raises:
        InvalidRecordingError: it is not rigid.
    """
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
    content = dict(content)
    matrix = content.get("intrinsic_matrix")
    if isinstance(matrix, list) and len(matrix) == 9:
        content |= {"fx": matrix[0], "fy": matrix[4], "cx": matrix[6], "cy": matrix[7]}
    numbers = {}
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        value = content.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InvalidRecordingError(f"{path}: {place}{name} is {value!r}; write a number")
        numbers[name] = value
    size = {name: numbers.pop(name) for name in ("width", "height")}
    if not all(isinstance(side, int) for side in size.values()):
        raise InvalidRecordingError(f"{path}: {place}width and height must be whole: {size}")
    coefficients = content.get("distortion", [])
    if not isinstance(coefficients, list) or not all(
        isinstance(value, int | float) for value in coefficients
    ):
        raise InvalidRecordingError(f"{path}: {place}distortion is not a list of numbers")
    model = content.get("model", "brown")
    if model not in ("brown", "fisheye"):
        raise InvalidRecordingError(
            f'{path}: {place}model is {model!r}; write "brown" or "fisheye"'
        )
    try:
        intrinsics = Intrinsics(
            **size,
            **{name: float(value) for name, value in numbers.items()},
            distortion=tuple(map(float, coefficients)),
            fisheye=model == "fisheye",
        )
    except (InvalidRecordingError, OverflowError) as error:
        raise InvalidRecordingError(f"{path}: {place}{error}") from error
    if not (intrinsics.fx > 0 and intrinsics.fy > 0):
        raise InvalidRecordingError(f"{path}: {place}fx and fy must be positive pixels")
    return intrinsics


def _positive(path: Path, content: dict[str, Any], name: str) -> float | None:
    value = content.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InvalidRecordingError(f"{path}: {name} is {value!r}; write a number")
    if not (value > 0 and math.isfinite(value)):
        raise InvalidRecordingError(f"{path}: {name} is {value!r}; it must be positive")
    return float(value)


def _depth_scale(path: Path, content: dict[str, Any]) -> float | None:
    """Open3D's `depth_scale`: units per metre."""
    scale = _positive(path, content, "depth_scale")
    return None if scale is None else 1.0 / scale
