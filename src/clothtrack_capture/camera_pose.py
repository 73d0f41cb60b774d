"""Calibration of a recording's camera poses from the table, a board or a robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.table_plane import TableFit, world_from_table
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recorded_table import fit_recorded_table, moved_along
from clothtrack.recordings.recording import Recording, Table
from clothtrack_capture.amendment import amend_document
from clothtrack_capture.board import Board, BoardPose, locate_board, locate_boards
from clothtrack_capture.hand_eye import HandEye, RobotPose, calibrate_hand_eye

_BOARD_PICTURES = 8

DOUBTFUL_RESIDUAL_M, LARGEST_RESIDUAL_M = 0.004, 0.010
"""Root mean square distance of the table's depth from a plane [m] above which a placement is
reported as doubtful, and refused. A table 0.5 to 1 m away has 1 to 2 mm."""

_LEAST_INLIERS = 0.5
"""Share of the depth off the cloth that must lie on the plane; below it a placement is doubtful."""


@dataclass(frozen=True, eq=False)
class CameraPlacement:
    """The pose of a camera in the world, and how well it is known.

    Attributes:
        world_from_camera: rigid 4 x 4 [m]; gripper_from_camera for a camera on a hand.
        table: table in that world, or None if none was found.
        fit: method and quality of the fit, as numbers and words for JSON.
    """

    camera: str
    world_from_camera: Float[np.ndarray, "4 4"]
    table: Table | None
    fit: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the placement as JSON content."""
        table = None
        if self.table is not None:
            table = {"point": self.table.point.tolist(), "normal": self.table.normal.tolist()}
        return {
            "camera": self.camera,
            "world_from_camera": self.world_from_camera.tolist(),
            "table": table,
            "fit": dict(self.fit),
        }


def camera_named(recording: Recording, name: str = "") -> Camera:
    """Return the camera of a recording with this name; the first camera if the name is empty."""
    cameras = {camera.name: camera for camera in recording.cameras}
    if name and name not in cameras:
        raise InvalidConfigError(
            f"{recording.folder}: there is no camera {name!r}; cameras: {', '.join(cameras)}"
        )
    return cameras[name] if name else recording.cameras[0]


def place_by_table(recording: Recording, camera: Camera, *, force: bool = False) -> CameraPlacement:
    """Return the camera pose in a world whose plane z = 0 is the table, from depth alone."""
    fit = _plane_fit(recording, camera, force=force)
    pose = world_from_table(camera, fit)
    return CameraPlacement(camera.name, pose, _ground(), {"by": "table", **_fit_report(fit)})


def table_in_world(recording: Recording, camera: Camera, *, force: bool = False) -> CameraPlacement:
    """Return the table in the recording's existing world, from depth.

    The camera pose stays unchanged.
    """
    fit = _plane_fit(recording, camera, force=force, instead=" instead of --keep-world")
    table = _plane_in(camera.world_from_camera, fit)
    if table is None:
        raise InvalidRecordingError(
            f"{recording.folder}: camera {camera.name!r}: the plane found does not face up (along "
            "z) in the recording's world; correct world_from_camera, or leave --keep-world out"
        )
    text = {"by": "table", **_fit_report(fit)}
    return CameraPlacement(camera.name, camera.world_from_camera, table, text)


def _plane_fit(recording: Recording, camera: Camera, *, force: bool, instead: str = "") -> TableFit:
    """Return the plane in the depth; raise an error if the depth is not planar."""
    fit = fit_recorded_table(recording, camera)
    if fit.residual_m > LARGEST_RESIDUAL_M and not force:
        raise InvalidRecordingError(
            f"{recording.folder}: camera {camera.name!r}: the depth lies "
            f"{1e3 * fit.residual_m:.1f} mm (rms) from the plane found (at most "
            f"{1e3 * LARGEST_RESIDUAL_M:.0f}), which is no table then; let a bare table fill the "
            f"picture, give a board with --charuco{instead}, or use --force"
        )
    return fit


def placement_doubt(placement: CameraPlacement) -> str:
    """Return why a placement by the table's depth is doubtful; empty if it is not."""
    if placement.fit["by"] != "table":
        return ""
    residual_mm, share = placement.fit["residual_mm"], placement.fit["inlier_share"]
    if residual_mm > 1e3 * DOUBTFUL_RESIDUAL_M:
        return (
            f"residual_mm is {residual_mm:g} (1 to 2 for a table, doubtful above "
            f"{1e3 * DOUBTFUL_RESIDUAL_M:g})"
        )
    if share < _LEAST_INLIERS:
        return f"inlier_share is {share:g} (doubtful below {_LEAST_INLIERS:g})"
    return ""


def place_by_board(recording: Recording, camera: Camera, board: Board) -> CameraPlacement:
    """Return the camera pose in a world defined by a board that lies on the table.

    The origin is on the table under the middle of the board. The x axis runs along the board's
    columns and z points up.
    """
    frames = [frame for frame in recording.frames if camera.name in frame.color]
    if not frames:
        raise InvalidRecordingError(
            f"{recording.folder}: camera {camera.name!r} has no color pictures to find a board "
            "in; leave the board out and let depth find the table"
        )
    places = np.unique(np.linspace(0, len(frames) - 1, _BOARD_PICTURES).round().astype(int))
    seen = locate_board([read_color(frames[n].color[camera.name]) for n in places], board, camera)
    pose = np.linalg.inv(seen.camera_from_board)
    text = {
        "by": "board",
        "corners": seen.corners,
        "residual_px": round(seen.residual_px, 3),
        "camera_height_m": round(float(pose[2, 3]), 4),
    }
    deeper = _depth_behind_board(recording, camera, board, seen)
    if deeper is not None:
        text["depth_beyond_board_mm"] = round(1e3 * deeper, 1)
    return CameraPlacement(camera.name, pose, _ground(), text)


def place_by_robot(
    recording: Recording,
    camera: Camera,
    board: Board,
    poses: Sequence[RobotPose],
    *,
    camera_on_hand: bool = False,
) -> tuple[CameraPlacement, HandEye]:
    """Return the camera pose relative to a robot, from board pictures at known gripper poses.

    The world is the robot's base frame. The table is found from depth if a plane dominates it. With
    the camera on the hand the placement is gripper_from_camera.
    """
    pictures = [read_color(robot.picture) for robot in poses]
    for robot, picture in zip(poses, pictures, strict=True):
        if picture.shape[:2] != (camera.height, camera.width):
            raise InvalidRecordingError(
                f"{robot.picture}: {picture.shape[1]} x {picture.shape[0]} pixels, but camera "
                f"{camera.name!r} has {camera.width} x {camera.height}; use its own pictures"
            )
    seen = locate_boards(pictures, board, camera)
    used = [n for n, pose in enumerate(seen) if pose is not None]
    hand_eye = calibrate_hand_eye(
        [poses[n].base_from_gripper for n in used],
        [pose.camera_from_board for pose in seen if pose is not None],
        camera_on_hand=camera_on_hand,
    )
    text: dict[str, Any] = {
        "by": "camera on hand" if camera_on_hand else "robot",
        "pictures": len(poses),
        "pictures_used": len(used),
        "residual_mm": round(1e3 * float(np.sqrt(np.mean(hand_eye.errors_m**2))), 2),
        "residual_deg": round(float(np.sqrt(np.mean(hand_eye.errors_deg**2))), 3),
        "per_picture": [
            {
                "picture": str(poses[n].picture),
                "mm": round(1e3 * float(shift), 2),
                "deg": round(float(turn), 3),
            }
            for n, shift, turn in zip(used, hand_eye.errors_m, hand_eye.errors_deg, strict=True)
        ],
    }
    table = None
    if not camera_on_hand:
        table, said = _table_in(recording, camera, hand_eye.pose)
        text["table"] = said
    return CameraPlacement(camera.name, hand_eye.pose, table, text), hand_eye


def place_camera(
    recording: Recording, placement: CameraPlacement, *, force: bool = False
) -> Recording:
    """Return the recording with a camera placed, and the other cameras moved along with it."""
    camera = camera_named(recording, placement.camera)
    moved = not np.array_equal(camera.world_from_camera, placement.world_from_camera)
    fixed = _given_in_world(recording)
    if fixed and moved and not force:
        raise InvalidRecordingError(
            f"{recording.folder}: this would change the world of {' and '.join(fixed)}; if the "
            "camera's pose is in that world, find the table alone with --keep-world; else "
            "calibrate before they are made, or, if they are in the new world already, use --force"
        )
    poses = moved_along(recording, camera, placement.world_from_camera)
    fit = {"camera_placement": {"camera": placement.camera, **placement.fit}}

    def change(document: dict[str, Any]) -> None:
        for entry in document["cameras"]:
            entry["world_from_camera"] = poses[entry["name"]].tolist()
        document["table"] = placement.as_dict()["table"]
        document.setdefault("provenance", {}).update(fit)

    if not recording.in_memory:
        amend_document(recording.folder, change)
    return replace(
        recording,
        cameras=tuple(replace(c, world_from_camera=poses[c.name]) for c in recording.cameras),
        table=placement.table,
        provenance={**recording.provenance, **fit},
    )


def _given_in_world(recording: Recording) -> list[str]:
    """Return which data of a recording are expressed in its present world."""
    things = {
        "picker.csv": bool(recording.picker_paths),
        "the template": recording.cloth.template is not None,
        "the clouds": any(frame.cloud is not None for frame in recording.frames),
        "observed.lowest_height_m": recording.observed.lowest_height_m is not None,
    }
    return [name for name, there in things.items() if there]


def _fit_report(fit: TableFit) -> dict[str, Any]:
    return {
        "camera_height_m": round(fit.distance_m, 4),
        "tilt_deg": round(fit.tilt_deg, 2),
        "residual_mm": round(1e3 * fit.residual_m, 2),
        "inlier_share": round(fit.inlier_share, 3),
        "cloth_excluded": fit.cloth_excluded,
        "frames": fit.frames,
    }


def _ground() -> Table:
    return Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


def _depth_behind_board(
    recording: Recording, camera: Camera, board: Board, seen: BoardPose
) -> float | None:
    """Return how far the measured depth lies behind the board's pose [m] (median), or None."""
    frame = next((frame for frame in recording.frames if camera.name in frame.depth), None)
    if frame is None:
        return None
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    points = board.corners @ seen.camera_from_board[:3, :3].T + seen.camera_from_board[:3, 3]
    columns, rows = np.rint(
        points[:, :2] / points[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    ).T.astype(int)
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    measured = depth[rows[inside], columns[inside]]
    beyond = (measured - points[inside, 2])[measured > 0]
    return float(np.median(beyond)) if len(beyond) else None


def _table_in(
    recording: Recording, camera: Camera, pose: Float[np.ndarray, "4 4"]
) -> tuple[Table | None, dict[str, Any] | str]:
    """Return the table from depth and its fit report; None and the reason if it is not found."""
    try:
        fit = fit_recorded_table(recording, camera)
    except InvalidRecordingError as error:
        return None, str(error)
    table = _plane_in(pose, fit)
    if table is None:
        return None, "the plane found does not face up in the robot's base"
    return table, _fit_report(fit)


def _plane_in(pose: Float[np.ndarray, "4 4"], fit: TableFit) -> Table | None:
    """Return the plane in the world of a camera with this pose; None if it does not face up."""
    normal = pose[:3, :3] @ fit.normal
    return Table(pose[:3, 3] - fit.distance_m * normal, normal) if normal[2] > 0.5 else None
