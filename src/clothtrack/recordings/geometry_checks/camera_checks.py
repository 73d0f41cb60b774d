"""Checks of a camera against the table in its depth: the unit of the depth, and the pose."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.table_plane import TableFit
from clothtrack.recordings.geometry_checks.finding import Finding, unit_factor
from clothtrack.recordings.pictures import read_depth
from clothtrack.recordings.recorded_table import fit_recorded_table
from clothtrack.recordings.recording import Recording, Table

_LARGEST_TILT_DEG = 1.0
"""Angle between the recorded table and the one in the depth from which a pose is doubted [deg]. On
right recordings it is at most 0.1; 1 degree lifts a cloth of 0.4 m by 7 mm on one side."""

_LARGEST_SHIFT_M = 0.01
"""Distance of the two tables [m] from which a pose is doubted. On right recordings it is below 1
mm, and 5 mm if the camera was displaced by 5 mm on purpose. It is trusted up to 8."""

_FEWEST_STEPS = 3
_LARGEST_STEP_M = 0.006
"""Distance of neighboring depth values [m] from which the depth is too coarse. Depth in millimeters
has steps of 0.001; a structured-light sensor has 0.003 at 1 m."""

_SPREAD = 0.1
"""Largest difference between pixels of the ratio of measured and expected depth (quartiles of its
logarithm), because a wrong unit makes all depth wrong by one factor."""

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Transform from a camera frame with y up and z backward (OpenGL) to ours."""

_Plane = tuple[Float[np.ndarray, " 3"], float]
"""A unit normal in the camera's frame and the camera's height above the plane [m]."""


def camera_findings(recording: Recording) -> list[Finding]:
    """Return cameras whose depth contradicts the recorded table: at most one finding each."""
    findings = unit_findings(recording)
    if findings:
        return findings
    for place, camera in enumerate(recording.cameras):
        if recording.table is None or not any(camera.name in f.depth for f in recording.frames):
            continue
        found = _coarse(recording, camera)
        found = found or _wrong_pose(recording, camera, recording.table, place)
        findings += [found] if found else []
    return findings


def unit_findings(recording: Recording) -> list[Finding]:
    """Return cameras whose depth is that of the recorded table in another unit."""
    if recording.table is None:
        return []
    found = [
        _wrong_unit(recording, camera, recording.table, place)
        for place, camera in enumerate(recording.cameras)
        if any(camera.name in frame.depth for frame in recording.frames)
    ]
    return [each for each in found if each is not None]


def _coarse(recording: Recording, camera: Camera) -> Finding | None:
    """Return a finding where the depth of the first frame comes in large steps."""
    frame = next(frame for frame in recording.frames if camera.name in frame.depth)
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    measured = depth[depth > 0]
    if not len(measured):
        return None
    # Use depths near the median only, because far ones have larger steps.
    middle = float(np.median(measured))
    values = np.unique(measured[np.abs(measured - middle) < 0.1 * middle])
    step_m = float(np.median(np.diff(values))) if len(values) > _FEWEST_STEPS else 0.0
    if step_m <= _LARGEST_STEP_M:
        return None
    return Finding(
        "depth_steps", step_m, _LARGEST_STEP_M, "m", "frames: depth",
        f"the depth of camera {camera.name!r} comes in steps of {1e3 * step_m:.0f} mm (at most "
        f"{1e3 * _LARGEST_STEP_M:.0f}): write it as the camera gives it, without rounding",
    )  # fmt: skip


def _wrong_unit(recording: Recording, camera: Camera, table: Table, place: int) -> Finding | None:
    """Return a finding if the depth is that of the recorded table in another unit."""
    frame = next(frame for frame in recording.frames if camera.name in frame.depth)
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    normal, height = _recorded(camera.world_from_camera, table)
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    away = -(
        (columns - camera.cx) / camera.fx * normal[0]
        + (rows - camera.cy) / camera.fy * normal[1]
        + normal[2]
    )
    seen = (depth > 0) & (away > 1e-3)
    if height <= 0 or not seen.any():
        return None
    logs = np.log10(depth[seen] * away[seen] / height)
    low, middle, high = np.percentile(logs, [25, 50, 75])
    factor = unit_factor(float(10.0**middle))
    if factor is None or high - low > _SPREAD:
        return None
    unit_m, field = recording.depth_units_m[camera.name], f"cameras[{place}].depth_unit_m"
    measured, expected = float(np.median(depth[seen])), float(np.median(height / away[seen]))
    return Finding(
        "depth_unit", measured, expected, "m", field,
        f"the depth of camera {camera.name!r} is {measured:.3g} m where the recorded table is "
        f"{expected:.3g} m away: correct {field}, {unit_m:g} is likely to be {unit_m / factor:g}",
    )  # fmt: skip


def _wrong_pose(recording: Recording, camera: Camera, table: Table, place: int) -> Finding | None:
    """Return a finding if the table in the depth is tilted or shifted from the recorded one."""
    try:
        fit = fit_recorded_table(recording, camera)
    except InvalidRecordingError:
        return None  # No plane in the depth: nothing to compare with.
    tilt_deg, shift_m = _apart(fit, _recorded(camera.world_from_camera, table))
    if tilt_deg <= _LARGEST_TILT_DEG and abs(shift_m) <= _LARGEST_SHIFT_M:
        return None
    field = f"cameras[{place}].world_from_camera"
    remedy = f"correct {field}{_cause(camera, fit, table)}; clothtrack calibrate-camera finds it"
    shown = f"the table in the depth of camera {camera.name!r} is"
    if tilt_deg > _LARGEST_TILT_DEG:
        return Finding(
            "camera_pose", tilt_deg, _LARGEST_TILT_DEG, "deg", field,
            f"{shown} tilted by {tilt_deg:.1f} degrees against the recorded one (at most "
            f"{_LARGEST_TILT_DEG:g}): {remedy}",
        )  # fmt: skip
    expected = fit.distance_m - shift_m
    return Finding(
        "camera_pose", fit.distance_m, expected, "m", field,
        f"{shown} {fit.distance_m:.3f} m under it, the recorded one {expected:.3f} m: {remedy}, "
        "or correct the table",
    )  # fmt: skip


def _cause(camera: Camera, fit: TableFit, table: Table) -> str:
    """Return the likely mistake in the pose, if another pose fits; else what may be wrong."""
    pose = camera.world_from_camera
    others: Mapping[str, Float[np.ndarray, "4 4"]] = {
        "it looks inverted, the pose of the world in the camera": np.linalg.inv(pose),
        "its y and z look like those of OpenGL, y up and z backward": pose @ _FLIP,
        "it looks inverted and like OpenGL's, y up and z backward": np.linalg.inv(pose) @ _FLIP,
    }
    for words, other in others.items():
        tilt_deg, shift_m = _apart(fit, _recorded(other, table))
        if tilt_deg <= _LARGEST_TILT_DEG and abs(shift_m) <= _LARGEST_SHIFT_M:
            return f" ({words})"
    return ", or fx, fy, cx and cy of the camera"


def _recorded(world_from_camera: Float[np.ndarray, "4 4"], table: Table) -> _Plane:
    """Return the recorded table as a camera at this pose sees it."""
    normal = table.normal / np.linalg.norm(table.normal)
    height = float((world_from_camera[:3, 3] - table.point) @ normal)
    return world_from_camera[:3, :3].T @ normal, height


def _apart(fit: TableFit, recorded: _Plane) -> tuple[float, float]:
    """Return the angle [deg] and distance [m] from a recorded table to the one in the depth."""
    normal, height = recorded
    cosine = float(np.clip(fit.normal @ normal, -1.0, 1.0))
    return float(np.degrees(np.arccos(cosine))), fit.distance_m - height
