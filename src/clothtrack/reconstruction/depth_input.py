"""The depth picture to reconstruct, from a recording or from one file with camera parameters."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera, about_vertical
from clothtrack.geometry.table_plane import (
    LEAST_POINTS,
    PIXELS,
    fit_plane,
    off_cloth,
    sight_lines,
    world_from_table,
)
from clothtrack.reconstruction.data.cloud_picture import cloud_picture
from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
from clothtrack.reconstruction.data.view import LEAST_PIXELS
from clothtrack.recordings.pictures import read_depth, read_mask
from clothtrack.recordings.point_cloud import cloth_measured
from clothtrack.recordings.recording import Table
from clothtrack.recordings.segmentation import LOWEST_M, HeightSegmenter
from clothtrack.recordings.store import read_recording

_USUAL_FOCAL = 0.94
"""Focal length over picture width of a usual depth camera: 56 degrees across."""

_DISTANCES_M = (0.05, 20.0)
"""Range of plausible table distances [m]; outside it, the depth's unit is probably another."""

_LEAST_TABLE = 0.05
"""Share of the picture that must show the table for a plane to be fitted."""

_DISTANCE_STEP_M = 0.004


@dataclass(frozen=True, eq=False)
class DepthInput:
    """Input of a reconstruction network.

    Attributes:
        depth_m: measured depth [m]; 0 where nothing was measured.
        mask: pixels where cloth was measured.
        camera: camera that took the picture; world z up.
        size_m: width and length of the garment [m], if known.
        table_source: source of the camera pose over the table: the recording states it, a plane is
            fitted to the depth, or the camera is assumed to look straight down.
        table_residual_m: root mean square distance of the table's pixels from the fitted plane
            [m]; None if none is fitted.
    """

    depth_m: Float[np.ndarray, "height width"]
    mask: Bool[np.ndarray, "height width"]
    camera: Camera
    table: Table | None
    kind: str | None = None
    size_m: tuple[float, float] | None = None
    table_source: Literal["recorded", "fitted", "assumed"] = "recorded"
    table_residual_m: float | None = None

    def scaled(self, factor: float) -> "DepthInput":
        """Return the same picture of a world that is larger by a factor."""
        table = self.table
        if table is not None:
            table = replace(table, point=np.asarray(table.point) * factor)
        residual_m = self.table_residual_m
        return replace(
            self,
            depth_m=self.depth_m * factor,
            camera=self.camera.scaled(factor),
            table=table,
            size_m=None
            if self.size_m is None
            else (self.size_m[0] * factor, self.size_m[1] * factor),
            table_residual_m=None if residual_m is None else residual_m * factor,
        )

    def turned(self, angle_rad: float) -> "DepthInput":
        """Return the same picture of a world turned about the vertical through its origin."""
        turn, table = about_vertical(angle_rad), self.table
        if table is not None:
            table = replace(table, point=turn @ table.point, normal=turn @ table.normal)
        return replace(self, camera=self.camera.turned(angle_rad), table=table)


def from_recording(folder: Path, frame: int) -> DepthInput:
    """Read a frame of a recording."""
    recording = read_recording(folder)
    if not 0 <= frame < len(recording.frames):
        raise InvalidRecordingError(
            f"{folder}: there is no frame {frame}; it has 0 to {len(recording.frames) - 1}"
        )
    depth, mask, camera = cloth_picture(recording, recording.frames[frame])
    cloth = recording.cloth
    return DepthInput(depth, mask, camera, recording.table, cloth.kind, cloth.size_m)


def from_cloud(
    points: Float[np.ndarray, "points 3"],
    table: Table | None = None,
    *,
    kind: str | None = None,
    size_m: tuple[float, float] | None = None,
) -> DepthInput:
    """Render points of a cloth [m], world, z up, as measured by a camera straight above.

    Args:
        size_m: width and length of the garment [m], if known.
    """
    depth, mask, camera = cloud_picture(points)
    return DepthInput(depth, mask, camera, table, kind, size_m)


def from_picture(
    path: Path,
    *,
    mask: Path | None = None,
    depth_unit_m: float = 0.001,
    focal: float | None = None,
    principal_point: tuple[float, float] | None = None,
    table_distance_m: float | None = None,
) -> DepthInput:
    """Read a 16-bit depth picture of a camera that looks down on a table.

    Args:
        focal: focal length [pixels]; that of a usual camera when None.
        principal_point: column and row [pixels]; the middle of the picture when None.
        table_distance_m: distance to the table of a camera that looks straight down [m]; when
            None, the table's plane is fitted to the depth (`from_depth`).
    """
    _require_positive(depth_unit=depth_unit_m)
    depth = read_depth(path, depth_unit_m)
    return from_depth(
        depth,
        str(path),
        mask=mask,
        focal=focal,
        principal_point=principal_point,
        table_distance_m=table_distance_m,
    )


def from_depth(
    depth: Float[np.ndarray, "height width"],
    name: str,
    *,
    mask: Path | None = None,
    focal: float | None = None,
    principal_point: tuple[float, float] | None = None,
    table_distance_m: float | None = None,
) -> DepthInput:
    """Return the input for measured depth [m] of a camera that looks down on a table.

    The table is the plane that most of the depth beside the cloth lies on, at any tilt. It becomes
    the world's z = 0, and the origin is in the middle of the picture. If hardly any table is
    visible (`_LEAST_TABLE`), the camera is assumed to look straight down, at a height equal to the
    most frequent depth.

    Args:
        depth: measured depth [m]; 0 where nothing was measured.
        focal: focal length [pixels].
        principal_point: column and row [pixels].
        table_distance_m: distance to the table of a camera that looks straight down [m].
    """
    _require_positive(focal=focal, table_distance=table_distance_m)
    height, width = depth.shape
    focal = focal or _USUAL_FOCAL * width
    column, row = principal_point or ((width - 1) / 2, (height - 1) / 2)
    camera = Camera("top", width, height, focal, focal, column, row)
    marked = None if mask is None else _read_mask(mask, depth, name)
    fitted = None if table_distance_m is not None else _fitted_table(depth, marked, camera, name)
    if fitted is None:
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = table_distance_m or _usual_depth(depth, name)
        residual_m = None
    else:
        pose, residual_m = fitted
    camera = replace(camera, world_from_camera=pose)
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    cloth = HeightSegmenter()(None, depth, camera, table) if marked is None else marked
    measured = cloth_measured(depth, cloth, camera)
    if marked is None and int(measured.sum()) < LEAST_PIXELS:
        raise InvalidRecordingError(
            f"{name}: nothing stands out of the table by more than {1e3 * LOWEST_M:.0f} mm, where "
            "no mask says what is cloth; thin flat cloth needs one: --mask FILE"
        )
    return DepthInput(
        depth,
        measured,
        camera,
        table,
        table_source="assumed" if fitted is None else "fitted",
        table_residual_m=residual_m,
    )


def _require_positive(**given: float | None) -> None:
    for name, value in given.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise InvalidConfigError(f"{name} is {value}; it must be positive and finite")


def _read_mask(
    file: Path, depth: Float[np.ndarray, "height width"], name: str
) -> Bool[np.ndarray, "height width"]:
    mask = read_mask(file)
    if mask.shape != depth.shape:
        raise InvalidRecordingError(
            f"{file} has {mask.shape[1]} x {mask.shape[0]} pixels, {name} has {depth.shape[1]} x "
            f"{depth.shape[0]}; give a mask of the same picture"
        )
    return mask


def _fitted_table(
    depth: Float[np.ndarray, "height width"],
    cloth: Bool[np.ndarray, "height width"] | None,
    camera: Camera,
    name: str,
) -> tuple[Float[np.ndarray, "4 4"], float] | None:
    """Return the pose of the camera (world from camera) over the table, and its residual [m].

    None if hardly any table was measured.
    """
    beside = depth if cloth is None else off_cloth(depth, cloth)
    measured = int((beside > 0).sum())
    if measured < max(_LEAST_TABLE * depth.size, LEAST_POINTS):
        return None
    typical_m = float(np.median(beside[beside > 0]))
    if not _DISTANCES_M[0] < typical_m < _DISTANCES_M[1]:
        raise InvalidRecordingError(
            f"{name}: what it shows is {typical_m:.4g} m away (allowed {_DISTANCES_M[0]:g} to "
            f"{_DISTANCES_M[1]:g} m); is the depth's unit another?"
        )
    stride = max(1, measured // PIXELS)
    try:
        fit = fit_plane(*sight_lines(beside, camera, stride=stride))
        return world_from_table(camera, fit), fit.residual_m
    except InvalidRecordingError as error:
        remedy = "--table-distance is for a camera that looks straight down"
        if cloth is None:
            remedy = f"--mask says what is cloth, and {remedy}"
        raise InvalidRecordingError(f"{name}: {error}; {remedy}") from error


def _usual_depth(depth: Float[np.ndarray, "height width"], name: str) -> float:
    """Return the most frequent depth [m], which is the table's for a cloth on a table."""
    measured = depth[depth > 0]
    if len(measured) == 0:
        raise InvalidRecordingError(
            f"{name}: no pixel has a depth; check that the camera measured, and the file's unit"
        )
    steps = np.bincount((measured / _DISTANCE_STEP_M).astype(np.int64))
    step = int(steps.argmax())
    near = measured[np.abs(measured / _DISTANCE_STEP_M - step - 0.5) < 1.0]
    return float(np.median(near))
