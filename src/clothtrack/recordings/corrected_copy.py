"""A corrected copy of a recording, from what the checks of its geometry suggest."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.geometry_checks.corrections import (
    ClockScale,
    ColorFlip,
    ColorScale,
    ColorShift,
    ColorTurn,
    Correction,
    LensDistortion,
    PickerDelay,
    StreamDelay,
)
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.pictures import read_cloud, read_color, read_depth, read_mask
from clothtrack.recordings.recording import PickerPath, Recording
from clothtrack.recordings.store import RecordingWriter

_Change = Callable[[np.ndarray], np.ndarray]


def write_corrected(
    recording: Recording, findings: Sequence[Finding], folder: Path
) -> tuple[Correction, ...]:
    """Write a copy with every correction that the findings carry; the original stays as it is.

    Masks are corrected like the color, which they are made from, unless a finding says that they
    do not fit it.

    Args:
        recording: the recording, with one camera if pictures are to be changed.
        findings: findings of `check_geometry`.
        folder: folder of the copy; must not exist.

    Returns:
        The corrections that were made.

    Raises:
        InvalidRecordingError: no finding carries a correction, pictures of several cameras would
            have to be changed, or a picture cannot be read.
        StorageError: the folder exists or the disk refuses.
    """
    corrections = tuple(each.correction for each in findings if each.correction is not None)
    pictured = [each for each in corrections if not isinstance(each, ClockScale | PickerDelay)]
    if not findings:
        raise InvalidRecordingError(
            f"{recording.folder}: nothing in it is doubtful, so {folder} is not written; track it"
        )
    if not corrections or (pictured and len(recording.cameras) > 1):
        why = "of several cameras are not corrected" if corrections else "need no known correction"
        raise InvalidRecordingError(
            f"{recording.folder}: its pictures {why}, so {folder} is not written; correct what "
            f"clothtrack inspect {recording.folder} names by hand"
        )
    masks_follow = not any(each.kind in ("mask_small", "mask_large") for each in findings)
    with RecordingWriter(
        folder,
        recording.cameras,
        recording.depth_units_m,
        table=recording.table,
        cloth=recording.cloth,
        observed=recording.observed,
        provenance={**recording.provenance, "corrected": [repr(each) for each in corrections]},
    ) as writer:
        _write_frames(writer, recording, corrections, masks_follow=masks_follow)
        count = len(recording.frames) - _delay(corrections)
        for action in recording.actions:
            last = min(action.last_frame, count - 1)
            if action.first_frame < last:
                writer.add_action(action.first_frame, last, action.pickers)
        for name, path in recording.picker_paths.items():
            writer.set_picker_path(name, _corrected_path(path, corrections))
    return corrections


def _write_frames(
    writer: RecordingWriter,
    recording: Recording,
    corrections: Sequence[Correction],
    *,
    masks_follow: bool,
) -> None:
    """Write every frame with its streams paired anew; times are those of the timely stream."""
    late = [each for each in corrections if isinstance(each, StreamDelay)]
    behind = {each.stream: each.frames for each in late}
    factor = float(np.prod([each.factor for each in corrections if isinstance(each, ClockScale)]))
    color_delay, depth_delay = behind.get("color", 0), behind.get("depth", 0)
    mask_delay = color_delay if masks_follow else depth_delay
    for place in range(len(recording.frames) - _delay(corrections)):
        here = recording.frames[place]
        color = recording.frames[place + color_delay].color
        depth = recording.frames[place + depth_delay].depth
        mask = recording.frames[place + mask_delay].mask
        changes = {each.name: _changes(each, corrections) for each in recording.cameras}
        writer.add_frame(
            here.time_s * factor,
            color={name: changes[name][0](read_color(path)) for name, path in color.items()},
            depth={
                name: changes[name][1](read_depth(path, recording.depth_units_m[name]))
                for name, path in depth.items()
            },
            mask={
                name: changes[name][0 if masks_follow else 1](
                    read_mask(path).astype(np.uint8)
                ).astype(bool)
                for name, path in mask.items()
            },
            cloud=None if here.cloud is None else read_cloud(here.cloud),
        )


def _delay(corrections: Sequence[Correction]) -> int:
    """Return the number of frames at the end that lose their partner."""
    return sum(each.frames for each in corrections if isinstance(each, StreamDelay))


def _changes(camera: Camera, corrections: Sequence[Correction]) -> tuple[_Change, _Change]:
    """Return the changes to the color pictures of a camera, and to its depth pictures."""

    def change(picture: np.ndarray, *, color: bool) -> np.ndarray:
        for each in corrections:
            if isinstance(each, LensDistortion):
                picture = _undistorted(picture, camera, each.k1)
            elif color:
                picture = _placed(picture, each)
        return picture

    return lambda picture: change(picture, color=True), lambda picture: change(picture, color=False)


def _placed(picture: np.ndarray, correction: Correction) -> np.ndarray:
    """Return a color picture moved onto the depth; black where it does not reach."""
    height, width = picture.shape[:2]
    if isinstance(correction, ColorFlip):
        rows, columns = (-1 if turn else 1 for turn in (correction.rows, correction.columns))
        return np.ascontiguousarray(picture[::rows, ::columns])
    if isinstance(correction, ColorShift):
        matrix = np.array([[1.0, 0.0, correction.columns], [0.0, 1.0, correction.rows]])
        return cv2.warpAffine(picture, matrix, (width, height), flags=cv2.INTER_NEAREST)
    if isinstance(correction, ColorScale | ColorTurn):
        middle = ((width - 1) / 2, (height - 1) / 2)
        scaled = isinstance(correction, ColorScale)
        degrees, factor = (0.0, correction.factor) if scaled else (correction.degrees, 1.0)
        matrix = cv2.getRotationMatrix2D(middle, degrees, factor)
        return cv2.warpAffine(picture, matrix, (width, height), flags=cv2.INTER_NEAREST)
    return picture


def _undistorted(picture: np.ndarray, camera: Camera, k1: float) -> np.ndarray:
    """Return the picture of a pinhole camera of the same intrinsics; depth is not blended."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    columns, rows = cv2.initUndistortRectifyMap(
        matrix, np.array([k1, 0.0, 0.0, 0.0]), np.eye(3), matrix, picture.shape[1::-1],
        cv2.CV_32FC1,
    )  # fmt: skip
    return cv2.remap(picture, columns, rows, cv2.INTER_NEAREST)


def _corrected_path(path: PickerPath, corrections: Sequence[Correction]) -> PickerPath:
    """Return the path by the right clock, extended at rest so that it covers the same times."""
    for each in corrections:
        if isinstance(each, ClockScale):
            path = replace(path, time_s=path.time_s * each.factor)
        if isinstance(each, PickerDelay):
            begin, end = path.time_s[0], path.time_s[-1]
            late = each.seconds > 0
            times, rest = path.time_s + each.seconds, 0 if late else -1
            path = PickerPath(
                np.concatenate([[begin], times] if late else [times, [end]]),
                np.insert(path.positions, 0 if late else len(times), path.positions[rest], axis=0),
                np.insert(path.closed, 0 if late else len(times), False),
            )
    return path
