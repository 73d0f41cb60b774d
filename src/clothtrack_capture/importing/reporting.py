"""Puts the report of an import together."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.recording import ClothDescription, PickAndPlace, PickerPath
from clothtrack_capture.importing.import_report import ImportReport
from clothtrack_capture.importing.pairing import Pairing
from clothtrack_capture.importing.registration import Registration
from clothtrack_capture.importing.source import Streams


def report_of(
    source: Path,
    folder: Path,
    streams: Streams,
    pairing: Pairing,
    registration: Registration,
    *,
    camera: Camera,
    times: Sequence[float],
    damaged: Counter[str],
    paths: Mapping[str, PickerPath],
    actions: Sequence[PickAndPlace],
    notes: Sequence[str],
    posed: bool,
    table: bool,
    cloth: ClothDescription,
) -> ImportReport:
    """Return what was found, left out and is missing."""
    duration = times[-1] - times[0]
    return ImportReport(
        recording=folder,
        source=source,
        kind=streams.kind,
        frames=len(times),
        duration_s=duration,
        frames_per_s=(len(times) - 1) / duration if duration > 0 else 0.0,
        camera=(
            f"{camera.name}, {camera.width} x {camera.height}, fx {camera.fx:.1f}"
            + ("" if posed else ", pose not known: its frame stands in for the world")
        ),
        streams=streams.origins,
        depth_unit_m=streams.calibration.depth_unit_m,
        depth_unit_origin=streams.calibration.unit_origin,
        registration=_registration(streams, registration),
        tolerance_s=pairing.tolerance_s,
        worst_apart_s=pairing.worst_s,
        dropped=_dropped(pairing, damaged),
        notes=[*streams.notes, *notes],
        pickers={name: len(path.time_s) for name, path in paths.items()},
        actions=[(action.first_frame, action.last_frame) for action in actions],
        missing=_missing(
            folder, streams, pickers=bool(paths), actions=bool(actions), posed=posed,
            table=table, cloth=cloth,
        ),
        next_command=(
            f"clothtrack inspect {folder}"
            if table
            else f"clothtrack calibrate-camera {folder} --keep-world"
            if posed
            else f"clothtrack calibrate-camera {folder}{_aside(paths)}"
        ),
    )  # fmt: skip


def _aside(pickers: object) -> str:
    """Return the option that keeps a calibration out of a recording that has a picker path."""
    return " --output camera.json" if pickers else ""


def _registration(streams: Streams, registration: Registration) -> str:
    calibration = streams.calibration
    if registration.carried:
        return "depth carried to the colour camera, nearest wins, uncovered pixels 0"
    if not calibration.depth.straight:
        return "none needed; distortion taken out"
    return "none needed" if calibration.color is not None else "none needed: no colour"


def _dropped(pairing: Pairing, damaged: Counter[str]) -> list[str]:
    dropped = []
    if pairing.depth_alone:
        advice = f" ({pairing.advice})" if pairing.advice else ""
        dropped.append(
            f"{pairing.depth_alone} depth pictures without colour near enough in time{advice}"
        )
    if pairing.color_alone:
        dropped.append(f"{pairing.color_alone} colour pictures without depth near enough in time")
    if pairing.doubles:
        dropped.append(f"{pairing.doubles} depth pictures with the time stamp of another")
    dropped += [f"{count} frames: {reason}" for reason, count in damaged.most_common(5)]
    if len(damaged) > 5:
        rest = sum(damaged.values()) - sum(count for _, count in damaged.most_common(5))
        dropped.append(f"{rest} more frames that cannot be decoded")
    return dropped


def _missing(
    folder: Path,
    streams: Streams,
    *,
    pickers: bool,
    actions: bool,
    posed: bool,
    table: bool,
    cloth: ClothDescription,
) -> list[str]:
    missing = []
    if not posed:
        again = (
            "; then import again with --world-from-camera camera.json, so that the path "
            "stands in the same world"
        )  # fmt: skip
        missing.append(
            "the table and the camera's pose (world_from_camera): clothtrack calibrate-camera "
            f"{folder}{_aside(pickers)} finds both{again if pickers else ''}"
        )
    elif not table:
        missing.append(f"the table: clothtrack calibrate-camera {folder} --keep-world finds it")
    if not pickers:
        missing.append(
            f"the picker's path: clothtrack find-picker {folder} finds a coloured tip in the "
            "pictures (--tip-color NAME), or a bare hand by clicks (--by-hand); or write "
            "picker.csv (docs/data_format.md), or import again with --picker-csv, --picker-topic "
            "or --picker-frame"
        )
    elif not actions:
        missing.append(
            "actions: the path never closes; import again with --gripper-topic, a column `closed`, "
            "or --actions FIRST-LAST"
        )
    if cloth.kind not in ("towel", "tshirt"):
        missing.append(
            "the cloth's kind: --cloth towel or tshirt, or cloth.kind in recording.json; any other "
            "garment needs a template (clothtrack garment)"
            if cloth.kind == "other"
            else f"a template: {cloth.kind} are tracked from one (clothtrack garment)"
        )
    if streams.color is not None and cloth.color is None:
        missing.append(
            f"which pixels are cloth: clothtrack segment {folder} by a click, or its colour by "
            "--cloth-color NAME, or cloth.color in recording.json"
        )
    return missing
