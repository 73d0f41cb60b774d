"""JSON files with intrinsics, for sources that do not contain them."""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.files.bounds import Bounds
from clothtrack.geometry.camera import rigid_problem
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.source import StereoCalibration, listed
from clothtrack_capture.importing.units import DepthUnit

_LARGEST_FILE = 16 * 2**20
_FIELDS = (
    dict.fromkeys(("width", "height"), (int, Bounds(least=1)))
    | dict.fromkeys(("fx", "fy", "fps", "depth_scale"), (float, Bounds(above=0)))
    | dict.fromkeys(("cx", "cy"), (float, Bounds()))
)
"""Type and limits of every number in the file."""
_SPELLINGS = {
    "width": ("image_width", "w"), "height": ("image_height", "h"), "cx": ("ppx",), "cy": ("ppy",),
    "model": ("distortion_model",), "distortion": ("coeffs", "distortion_coefficients", "D", "d"),
    "matrix": ("intrinsic_matrix", "camera_matrix", "cam_K", "K", "k", "intrinsic", "intrinsics"),
}  # fmt: skip
"""Other programs' names of the fields."""
_NESTED = ("intrinsics", "intrinsic", "camera", "camera_info", "color", "rgb")
_BROWN, _FISHEYE = ("brown", "plumb_bob", "rational_polynomial"), ("fisheye", "equidistant")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
_KNOWN = {
    "fx", "fy", "fps", "depth_scale", "depth", "color", "color_from_depth", "serial",
    "name", "comment", *_NESTED, *_COEFFICIENTS, *_SPELLINGS,
    *(name for names in _SPELLINGS.values() for name in names),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class IntrinsicsFile:
    """The content of the file; the transform is rigid, depth camera to color camera [m]."""

    path: Path
    depth: Intrinsics
    color: Intrinsics
    color_from_depth: Float[np.ndarray, "4 4"]
    fps: float | None = None
    unit: DepthUnit | None = None
    notes: list[str] = field(default_factory=list)

    def calibration(self, *, with_color: bool) -> StereoCalibration:
        """Return the calibration of a source's pictures."""
        color = self.color if with_color else None
        return StereoCalibration(self.depth, color, self.color_from_depth, str(self.path))


def read_json(path: Path) -> Any:
    """Return the content of a JSON file of limited size."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise InvalidRecordingError(
                f"{path}: {path.stat().st_size} bytes; such a file has at most {_LARGEST_FILE}"
            )
        return json.loads(text_of(path.read_bytes()))
    except OSError as error:
        raise InvalidRecordingError(f"{path}: {error.strerror}; check the name") from error
    except (ValueError, RecursionError) as error:
        raise InvalidRecordingError(f"{path}: broken JSON ({error}); correct it") from error


def text_of(data: bytes) -> str:
    """Return the text of a file in UTF-8, in UTF-16 with its mark, or else in Latin-1."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_intrinsics(path: Path) -> IntrinsicsFile:
    """Return the intrinsics in a JSON file.

    The file has either one set of intrinsics for both pictures, which then must be registered
    (`width`, `height` and `fx`, `fy`, `cx`, `cy`, or a matrix of 3 x 3 or nine numbers), or
    `depth`, `color` and `color_from_depth`. A set may have `distortion` and `model` ("brown" or
    "fisheye"). Other programs' names of these fields are known too.
    """
    content = read_json(path)
    if not isinstance(content, dict):
        raise InvalidRecordingError(f"{path}: not a JSON object; see docs/import.md")
    unused = sorted(content.keys() - _KNOWN)
    notes = [f"fields of {path.name} that were not used: {listed(unused)}"] if unused else []
    fps, unit = _optional(path, content, "fps"), _unit(path, content)
    if not isinstance(content.get("depth"), dict):
        one = _intrinsics(path, content, "")
        return IntrinsicsFile(path, one, one, np.eye(4), fps, unit, notes)
    depth = _intrinsics(path, content["depth"], "depth.")
    color = _intrinsics(path, content.get("color", content["depth"]), "color.")
    pose = rigid_matrix(f"{path}: color_from_depth", content.get("color_from_depth", np.eye(4)))
    return IntrinsicsFile(path, depth, color, pose, fps, unit, notes)


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
    for name in _NESTED:
        if isinstance(content.get(name), dict) and not {"fx", "width"} <= content.keys():
            content, place = content | content[name], place or f"{name}."
    for name, spellings in _SPELLINGS.items():
        known = [content[one] for one in (name, *spellings) if content.get(one) is not None]
        content = content | ({name: known[0]} if known else {})
    content = content | _of_matrix(f"{path}: {place}", content.get("matrix"))
    numbers = {name: _number(f"{path}: {place}", content, name)
               for name in ("width", "height", "fx", "fy", "cx", "cy")}  # fmt: skip
    model = content.get("model", "brown")
    if model not in (*_BROWN, *_FISHEYE):
        raise InvalidRecordingError(
            f'{path}: {place}model is {model!r}; write "brown" or "fisheye"'
        )
    try:
        return Intrinsics(**numbers, distortion=_distortion(f"{path}: {place}", content),
                          fisheye=model in _FISHEYE)  # fmt: skip
    except (InvalidRecordingError, OverflowError) as error:
        raise InvalidRecordingError(f"{path}: {place}{error}; correct it") from error


def _distortion(place: str, content: dict[str, Any]) -> tuple[float, ...]:
    values = content.get("distortion", [])
    if isinstance(values, dict):
        values, content = values.get("data"), content | values
    if not values and content.keys() & {*_COEFFICIENTS}:
        values = [content.get(name, 0.0) for name in _COEFFICIENTS]
    if not isinstance(values, list) or not all(isinstance(one, int | float) for one in values):
        raise InvalidRecordingError(
            f"{place}distortion is {str(values)[:40]!r}; give a list of numbers such as "
            "[0, 0, 0, 0, 0], or leave it out"
        )
    return tuple(map(float, values))


def _of_matrix(place: str, matrix: Any) -> dict[str, Any]:
    """Return fx, fy, cx and cy of a calibration matrix, by rows or by columns."""
    if isinstance(matrix, dict):
        matrix = matrix.get("data")
    if not isinstance(matrix, list):
        return {}
    flat: list[Any] = [one for row in matrix for one in (row if isinstance(row, list) else [row])]
    by_rows = len(flat) == 9 and not flat[6] and not flat[7]
    by_columns = len(flat) == 9 and not flat[2] and not flat[5]
    if not (by_rows or by_columns):
        raise InvalidRecordingError(
            f"{place}matrix is {str(matrix)[:60]}; write 3 rows of 3 numbers: "
            "[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    cx, cy = flat[2:6:3] if by_rows else flat[6:8]
    return {"fx": flat[0], "fy": flat[4], "cx": cx, "cy": cy}


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


def _unit(path: Path, content: dict[str, Any]) -> DepthUnit | None:
    """Return the unit of Open3D's `depth_scale`: units per meter."""
    scale = _optional(path, content, "depth_scale")
    if scale is None:
        return None
    return DepthUnit(1.0 / scale, f"depth_scale {scale:g} in {path.name}, units per meter")
