"""Pinhole intrinsics of other programs' cameras, with or without distortion, and files of them."""

import json
import sys
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from clothtrack.errors import InvalidRecordingError
from clothtrack.files.bounds import Bounds
from clothtrack.geometry.camera import Camera, rigid_problem
from clothtrack_capture.importing.units import DepthUnit

# More pixels mean a damaged header, because the largest supported sensor has 4096 x 3072.
MOST_PIXELS = 4096 * 4096
_BROWN_LENGTHS = (0, 4, 5, 8, 12, 14)
_STRAIGHT_BELOW, _RETURN_LIMIT_PX = 1e-9, 0.5
_WIDEST_RAY = 100.0  # tangent of the angle to the axis: less than a degree from the picture plane
_LARGEST_FILE = 16 * 2**20
_FIELDS = (
    dict.fromkeys(("width", "height"), (int, Bounds(least=1)))
    | dict.fromkeys(("fx", "fy", "fps", "depth_scale"), (float, Bounds(above=0)))
    | dict.fromkeys(("cx", "cy"), (float, Bounds()))
)  # type and limits of every number in the file
_SPELLINGS = {  # other programs' names of the fields
    "width": ("image_width", "w"), "height": ("image_height", "h"), "cx": ("ppx",), "cy": ("ppy",),
    "model": ("distortion_model",), "distortion": ("coeffs", "distortion_coefficients", "D", "d"),
    "matrix": ("intrinsic_matrix", "camera_matrix", "cam_K", "K", "k", "intrinsic", "intrinsics"),
}  # fmt: skip
_NESTED = ("intrinsics", "intrinsic", "camera", "camera_info", "color", "rgb")
_BROWN = ("brown", "plumb_bob", "rational_polynomial", "brown_conrady", "modified_brown_conrady")
_FISHEYE = ("fisheye", "equidistant", "kannala_brandt4")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
_KNOWN = {
    "fx", "fy", "fps", "depth_scale", "depth", "color", "color_from_depth", "serial",
    "name", "comment", *_NESTED, *_COEFFICIENTS, *_SPELLINGS,
    *(name for names in _SPELLINGS.values() for name in names),
}  # fmt: skip


@dataclass(frozen=True)
class Intrinsics:
    """Camera intrinsics with distortion [pixels]; pixel centers are at integers."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    # In OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6, or k1..k4 of a fisheye.
    distortion: tuple[float, ...] = ()
    fisheye: bool = False  # the model is equidistant instead of Brown and Conrady's

    def __post_init__(self) -> None:
        """Refuse impossible intrinsics."""
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(numbers).all():
            raise InvalidRecordingError(f"intrinsics {numbers} are not finite")
        if not (self.width > 0 and self.height > 0 and self.width * self.height <= MOST_PIXELS):
            size = f"{self.width} x {self.height}"
            raise InvalidRecordingError(f"a camera of {size} pixels; known are 1 to {MOST_PIXELS}")
        known = (4,) if self.fisheye else _BROWN_LENGTHS
        if len(self.distortion) not in known:
            raise InvalidRecordingError(
                f"a {'fisheye ' * self.fisheye}lens with {len(self.distortion)} distortion "
                f"coefficients; known are {', '.join(map(str, known))}"
            )

    @property
    def straight(self) -> bool:
        """Whether there is no distortion."""
        return not (self.fisheye or any(abs(one) > _STRAIGHT_BELOW for one in self.distortion))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self.width, self.height

    def rectified(self) -> "Intrinsics":
        """Return the pinhole with the same focal lengths and center but without distortion."""
        return replace(self, distortion=(), fisheye=False)

    def camera(self, name: str, world_from_camera: Float[np.ndarray, "4 4"]) -> Camera:
        """Return the recording's camera, for pictures without distortion."""
        return Camera(name, *self.size, self.fx, self.fy, self.cx, self.cy, world_from_camera)

    def same_pixels(self, other: "Intrinsics") -> bool:
        """Return whether both map every direction to the same pixel, to a thousandth of a pixel."""
        lenses = [(one.size, () if one.straight else (one.distortion, one.fisheye))
                  for one in (self, other)]  # fmt: skip
        return lenses[0] == lenses[1] and np.allclose(self.matrix, other.matrix, rtol=0, atol=1e-3)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def corner_rays(self) -> Float[np.ndarray, "rows columns 2"]:
        """Return the ray (x / z, y / z) of every pixel corner, one row and column more."""
        shape = self.height + 1, self.width + 1
        pixels = np.indices(shape, dtype=np.float64)[::-1].reshape(2, -1).T[:, None] - 0.5
        if self.straight:
            rays = (pixels[:, 0] - (self.cx, self.cy)) / (self.fx, self.fy)
            with np.errstate(over="ignore"):
                return rays.reshape(*shape, 2).astype(np.float32)
        coefficients = np.array(self.distortion)
        if self.fisheye:
            rays = cv2.fisheye.undistortPoints(pixels, self.matrix, coefficients)
            back = cv2.fisheye.distortPoints(rays, self.matrix, coefficients)
        else:
            stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
            # OpenCV 4 has a separate name for the function with a limit on iterations.
            undistort: Any = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
            eye, still = np.eye(3), np.zeros(3)
            rays = undistort(pixels, self.matrix, coefficients, R=eye, P=eye, criteria=stop)
            ahead = np.insert(rays[:, 0], 2, 1.0, axis=1)
            back, _ = cv2.projectPoints(ahead, still, still, self.matrix, coefficients)
        with np.errstate(invalid="ignore", over="ignore"):
            kept = np.abs(back - pixels).max(axis=(1, 2)) < _RETURN_LIMIT_PX
        rays = rays[:, 0]
        rays[~(kept & (np.abs(rays).max(axis=1) < _WIDEST_RAY))] = np.nan
        return rays.reshape(*shape, 2).astype(np.float32)

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        rectify: Any = cv2.fisheye if self.fisheye else cv2
        return rectify.initUndistortRectifyMap(
            self.matrix, np.array(self.distortion), np.eye(3), self.matrix, self.size, cv2.CV_16SC2
        )

    def straighten(
        self, picture: Shaped[np.ndarray, "height width *channels"], *, nearest: bool = False
    ) -> Shaped[np.ndarray, "height width *channels"]:
        """Return the undistorted picture."""
        if self.straight:
            return picture
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return cv2.remap(picture, *self._map, how, borderMode=cv2.BORDER_CONSTANT)


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """The intrinsics and the relative pose [m] of a depth camera's two sensors."""

    depth: Intrinsics
    color: Intrinsics | None
    color_from_depth: Float[np.ndarray, "4 4"]
    origin: str

    @property
    def registered(self) -> bool:
        """Whether the same pixel of both pictures already shows the same point."""
        if self.color is None:
            return True
        standing = np.abs(self.color_from_depth - np.eye(4)).max() < 1e-6
        return bool(standing and self.depth.same_pixels(self.color))


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
            raise InvalidRecordingError(f"{path}: more than {_LARGEST_FILE} bytes; name another")
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
    """Return the one set of registered pictures, or `depth`, `color` and `color_from_depth`."""
    content = read_json(path)
    if not isinstance(content, dict):
        raise InvalidRecordingError(f"{path}: not a JSON object; see docs/import.md")
    unused = ", ".join(sorted(content.keys() - _KNOWN))[:200]
    notes = [f"fields of {path.name} that were not used: {unused}"] if unused else []
    fps, scale = (None if content.get(name) is None else _number(f"{path}: ", content, name)
                  for name in ("fps", "depth_scale"))  # fmt: skip
    said = f"depth_scale {scale or 0:g} in {path.name}, units per meter"  # as Open3D writes it
    unit = None if scale is None else DepthUnit(1.0 / scale, said)
    if not isinstance(content.get("depth"), dict):
        one = _intrinsics(f"{path}: ", content)
        return IntrinsicsFile(path, one, one, np.eye(4), fps, unit, notes)
    depth = _intrinsics(f"{path}: depth.", content["depth"])
    color = _intrinsics(f"{path}: color.", content.get("color", content["depth"]))
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


def _intrinsics(place: str, content: Any) -> Intrinsics:
    if not isinstance(content, dict):
        raise InvalidRecordingError(f"{place.rstrip('.')} is not an object; see docs/import.md")
    for name in _NESTED:
        if isinstance(content.get(name), dict) and not {"fx", "width"} <= content.keys():
            content, place = content | content[name], place + f"{name}." * place.endswith(" ")
    for name, spellings in _SPELLINGS.items():
        known = [content[one] for one in (name, *spellings) if content.get(one) is not None]
        content = content | ({name: known[0]} if known else {})
    content = content | _of_matrix(place, content.get("matrix"))
    names = ("width", "height", "fx", "fy", "cx", "cy")
    if missing := [name for name in names if content.get(name) is None]:
        there = ", ".join(sorted(map(str, content)))[:200]
        raise InvalidRecordingError(f"{place}{', '.join(missing)} missing (there: {there}); add it")
    numbers = {name: _number(place, content, name) for name in names}
    model, bent = str(content.get("model", "brown")), _distortion(place, content)
    name = model.lower().replace(" ", "_").rpartition(".")[2].removeprefix("rs2_distortion_")
    # Without coefficients, only a fisheye's pictures are bent.
    if any(bent) and name not in (*_BROWN, *_FISHEYE):
        raise InvalidRecordingError(
            f'{place}model is {model!r} with coefficients; known are "brown" and "fisheye": give '
            "the coefficients of one of them, or rectify the pictures"
        )
    model = name
    try:
        return Intrinsics(**numbers, distortion=tuple(map(float, bent)), fisheye=model in _FISHEYE)
    except (InvalidRecordingError, OverflowError) as error:
        raise InvalidRecordingError(f"{place}{error}; correct it") from error


def _distortion(place: str, content: dict[str, Any]) -> list[Any]:
    values = content.get("distortion", [])
    if isinstance(values, dict):
        values, content = values.get("data"), content | values
    if not values and content.keys() & {*_COEFFICIENTS}:
        values = [content.get(name, 0.0) for name in _COEFFICIENTS]
    if not isinstance(values, list) or not all(isinstance(one, int | float) for one in values):
        words = f"{place}distortion is {str(values)[:40]!r}"
        raise InvalidRecordingError(f"{words}; write numbers such as [0, 0, 0, 0], or leave it out")
    return values


def _of_matrix(place: str, matrix: Any) -> dict[str, Any]:
    """Return fx, fy, cx and cy of a calibration matrix, by rows or by columns."""
    if isinstance(matrix, dict):
        matrix = matrix.get("data")
    if not isinstance(matrix, list):
        return {}
    flat: list[Any] = [one for row in matrix for one in (row if isinstance(row, list) else [row])]
    by_rows = len(flat) == 9 and not any(flat[6:8])
    if not by_rows and (len(flat) != 9 or any(flat[2:6:3])):
        words = f"{place}matrix is {str(matrix)[:60]}"
        raise InvalidRecordingError(f"{words}; write [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
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
