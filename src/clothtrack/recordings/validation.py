"""Is a recording on disk what the format says? Every violation, not only the first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import ClothTrackError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.colors import NAMED_COLORS
from clothtrack.recordings.frame_files import FARTHEST_MEDIAN_M, check_pictures, find_frames, inside
from clothtrack.recordings.picker_table import read_picker_paths
from clothtrack.recordings.recording import (
    ClothDescription,
    Frame,
    ObservedRegion,
    PickAndPlace,
    PickerPath,
    Recording,
    Table,
)
from clothtrack.recordings.recording_file import DOCUMENT, load_document
from clothtrack.recordings.template import held_problem, read_obj
from clothtrack.recordings.violation import Violation, shown, violation_of

PICKER_FILE = "picker.csv"
_TIME_TOLERANCE_S = 1e-3


@dataclass(frozen=True, eq=False)
class CheckedRecording:
    """A recording with what is wrong with it.

    Attributes:
        recording: the recording; None when `violations` is not empty.
        violations: in the order of the document.
    """

    recording: Recording | None
    violations: tuple[Violation, ...]


def check_recording(folder: Path, *, thorough: bool = False) -> CheckedRecording:
    """Read a recording and collect everything that is wrong with it.

    Args:
        folder: the recording's folder.
        thorough: decode every picture instead of headers, masks and first depths (slower).
    """
    folder = folder.resolve()
    document, violations = load_document(folder)
    if document is None:
        return CheckedRecording(None, tuple(violations))
    found: list[Violation] = []
    cameras = _cameras(document["cameras"], found)
    names = [entry["name"] for entry in document["cameras"]]
    units = {
        entry["name"]: float(entry["depth_unit_m"])
        for entry in document["cameras"]
        if "depth_unit_m" in entry
    }
    table = _table(document.get("table"), found)
    frames, misnamed = find_frames(folder, document["frames"], names)
    found += misnamed
    _require_units(frames, names, units, found)
    paths = _picker_paths(folder, found)
    found += _far_pickers(paths or {}, cameras)
    actions = _actions(document.get("actions", []), frames, paths, found)
    cloth = _cloth(folder, document.get("cloth", {}), paths, found)
    observed = document.get("observed", {})
    found += check_pictures(
        folder, frames, {camera.name: camera for camera in cameras}, units, thorough=thorough
    )
    if found:
        return CheckedRecording(None, tuple(found))
    recording = Recording(
        folder=folder,
        cameras=tuple(cameras),
        depth_units_m=units,
        frames=frames,
        actions=actions,
        picker_paths=paths or {},
        table=table,
        cloth=cloth,
        observed=ObservedRegion(
            _optional(observed.get("lowest_height_m")),
            float(observed.get("tool_clearance_m", 0.0)),
        ),
        provenance=document.get("provenance", {}),
    )
    return CheckedRecording(recording, ())


def _cameras(entries: Sequence[Mapping[str, Any]], found: list[Violation]) -> list[Camera]:
    cameras: list[Camera] = []
    for place, entry in enumerate(entries):
        field = f"cameras[{place}]"
        if entry["name"] in {other["name"] for other in entries[:place]}:
            problem, remedy = "two cameras of this name", "name each camera differently"
            found.append(
                Violation(DOCUMENT, f"{field}.name", shown(entry["name"]), problem, remedy)
            )
            continue
        pose = np.array(entry.get("world_from_camera", np.eye(4)), dtype=np.float64)
        try:
            camera = Camera(
                name=entry["name"],
                width=entry["width"],
                height=entry["height"],
                fx=float(entry["fx"]),
                fy=float(entry["fy"]),
                cx=float(entry["cx"]),
                cy=float(entry["cy"]),
                world_from_camera=pose,
            )
        except InvalidRecordingError as error:
            found.append(violation_of(error, Path(), DOCUMENT, field))
        else:
            cameras.append(camera)
            found += _implausible_lens(camera, field)
    return cameras


def _implausible_lens(camera: Camera, field: str) -> list[Violation]:
    for name, focal, side in (("fx", camera.fx, "width"), ("fy", camera.fy, "height")):
        size = getattr(camera, side)
        if not 0.15 * size <= focal <= 20 * size:
            problem = f"implausible for a {side} of {size} pixels ({0.15 * size:g} to {20 * size})"
            remedy = "write the focal length in pixels of this picture size"
            value = f"{focal:g}"
            return [Violation(DOCUMENT, f"{field}.{name}", value, problem, remedy)]
    found = []
    if not 0.75 <= camera.fx / camera.fy <= 4 / 3:
        value, problem = f"{camera.fx / camera.fy:.3g}", "pixels of a camera are nearly square"
        remedy = "were intrinsics of another picture size, or cx and cy, written there?"
        found.append(Violation(DOCUMENT, f"{field}.fx / fy", value, problem, remedy))
    middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    center = np.array([camera.cx, camera.cy])
    off, swapped_off = (float(np.abs(c - middle).max()) for c in (center, center[::-1]))
    if off > 0.1 * camera.width and swapped_off < 0.25 * off:
        problem = "far from the middle of the picture, and swapped they are not"
        remedy = "cx is the column and cy the row: swap them"
        value = f"({camera.cx:g}, {camera.cy:g})"
        found.append(Violation(DOCUMENT, f"{field}.cx, cy", value, problem, remedy))
    return found


def _table(entry: Mapping[str, Any] | None, found: list[Violation]) -> Table | None:
    if entry is None:
        return None
    normal = np.array(entry["normal"], dtype=np.float64)
    length = float(np.linalg.norm(normal))
    if not abs(length - 1.0) < 1e-3:
        remedy = "divide it by its length"
        problem = f"its length is {length:.4g}, not 1"
        found.append(Violation(DOCUMENT, "table.normal", shown(entry["normal"]), problem, remedy))
        return None
    if normal[2] <= 0:
        problem, remedy = "it points down; the world's z axis points up", "turn it around"
        found.append(Violation(DOCUMENT, "table.normal", shown(entry["normal"]), problem, remedy))
    return Table(np.array(entry["point"], dtype=np.float64), normal / length)


def _require_units(
    frames: Sequence[Frame],
    names: Sequence[str],
    units: Mapping[str, float],
    found: list[Violation],
) -> None:
    for place, name in enumerate(names):
        if name not in units and any(name in frame.depth for frame in frames):
            field = f"cameras[{place}].depth_unit_m"
            problem, remedy = "missing, but the camera has depth", "add it: 0.001 for millimetres"
            found.append(Violation(DOCUMENT, field, "", problem, remedy))


def _picker_paths(folder: Path, found: list[Violation]) -> dict[str, PickerPath] | None:
    if not (folder / PICKER_FILE).exists():
        return {}
    try:
        return read_picker_paths(folder / PICKER_FILE)
    except InvalidRecordingError as error:
        found.append(violation_of(error, folder, PICKER_FILE))
        return None


def _actions(
    entries: Sequence[Mapping[str, Any]],
    frames: Sequence[Frame],
    paths: Mapping[str, PickerPath] | None,
    found: list[Violation],
) -> tuple[PickAndPlace, ...]:
    actions = []
    previous = 0
    for place, entry in enumerate(entries):
        field = f"actions[{place}]"
        first, last = entry["first_frame"], entry["last_frame"]
        if last >= len(frames):
            problem, remedy = f"the last frame is {len(frames) - 1}", "name a frame that exists"
            found.append(Violation(DOCUMENT, f"{field}.last_frame", str(last), problem, remedy))
            continue
        if last <= first:
            problem = f"not after first_frame ({first})"
            remedy = "an action takes at least two frames"
            found.append(Violation(DOCUMENT, f"{field}.last_frame", str(last), problem, remedy))
            continue
        if first < previous:
            problem = f"overlaps the action before it, which ends at frame {previous}"
            remedy = "let actions follow each other (they may share one frame)"
            found.append(Violation(DOCUMENT, f"{field}.first_frame", str(first), problem, remedy))
        previous = last
        if paths is not None:
            times = frames[first].time_s, frames[last].time_s
            for name in entry["pickers"]:
                found += _uncovered(field, name, times, paths)
        actions.append(PickAndPlace(first, last, tuple(entry["pickers"])))
    return tuple(actions)


def _uncovered(
    field: str, name: str, times: tuple[float, float], paths: Mapping[str, PickerPath]
) -> list[Violation]:
    if name not in paths:
        problem = f"no such picker in {PICKER_FILE} (there: {', '.join(paths) or 'none'})"
        remedy = "correct the name or add the picker's path"
        return [Violation(DOCUMENT, f"{field}.pickers", shown(name), problem, remedy)]
    start, end = paths[name].time_s[[0, -1]].tolist()
    if start <= times[0] + _TIME_TOLERANCE_S and end >= times[1] - _TIME_TOLERANCE_S:
        return []
    problem = (
        f"it does not cover {field} of {DOCUMENT}, which lasts from {times[0]:g} to {times[1]:g} s"
    )
    remedy = "record the whole path, with the clock of the frames"
    value = f"{start:g} to {end:g}"
    return [Violation(PICKER_FILE, f"time_s of picker {name!r}", value, problem, remedy)]


def _far_pickers(paths: Mapping[str, PickerPath], cameras: Sequence[Camera]) -> list[Violation]:
    """Pickers farther from every camera than anything that is measured: not metres, most likely."""
    found = []
    for name, path in paths.items():
        distances = [np.linalg.norm(path.positions - one.position, axis=1) for one in cameras]
        nearest = np.min(distances, axis=0, initial=np.inf)
        far = np.flatnonzero(np.isfinite(nearest) & (nearest > FARTHEST_MEDIAN_M))
        if len(far):
            x, y, z = path.positions[far[0]]
            problem = (
                f"{nearest[far[0]]:.3g} m from the nearest camera (at most {FARTHEST_MEDIAN_M:g} m)"
            )
            remedy = f"write metres, in the world frame of the cameras in {DOCUMENT}"
            field = f"x_m, y_m, z_m of picker {name!r} at {path.time_s[far[0]]:g} s"
            found.append(Violation(PICKER_FILE, field, f"({x:g}, {y:g}, {z:g})", problem, remedy))
    return found


def _cloth(
    folder: Path,
    entry: Mapping[str, Any],
    paths: Mapping[str, PickerPath] | None,
    found: list[Violation],
) -> ClothDescription:
    color = entry.get("color")
    if color is not None and color.lower() not in NAMED_COLORS:
        remedy = f"choose from {', '.join(NAMED_COLORS)}, or leave it out"
        found.append(
            Violation(DOCUMENT, "cloth.color", shown(color), "an unknown colour name", remedy)
        )
    template = _template(folder, entry, found)
    held = {name: np.array(ids, dtype=np.int64) for name, ids in
            entry.get("held_vertices", {}).items()}  # fmt: skip
    for name, vertices in held.items():
        field = f"cloth.held_vertices.{name}"
        value = shown(vertices.tolist())
        if paths is not None and name not in paths:
            remedy = f"add its path to {PICKER_FILE}"
            found.append(Violation(DOCUMENT, field, value, "no such picker", remedy))
        if template is None and entry.get("template") is None:
            remedy = "add cloth.template"
            found.append(Violation(DOCUMENT, field, value, "there is no template", remedy))
        elif template is not None and (problem := held_problem(vertices, template.vertex_count)):
            remedy = "vertices are counted from 0 (OBJ files count from 1)"
            found.append(Violation(DOCUMENT, field, value, problem, remedy))
    size = entry.get("size_m")
    return ClothDescription(
        kind=entry.get("kind", "other"),
        color=None if color is None else color.lower(),
        size_m=None if size is None else (float(size[0]), float(size[1])),
        template=template,
        held_vertices=held,
        grasp_uncertainty_m=float(entry.get("grasp_uncertainty_m", 0.0)),
    )


def _template(folder: Path, entry: Mapping[str, Any], found: list[Violation]) -> ClothMesh | None:
    files: dict[str, Path] = {}
    for name in ("template", "template_canonical"):
        if entry.get(name) is not None:
            path = inside(folder, entry[name])
            if path is None:
                problem = "the path leads out of the recording"
                remedy = "put the file inside the folder"
                field, value = f"cloth.{name}", shown(entry[name])
                found.append(Violation(DOCUMENT, field, value, problem, remedy))
                return None
            files[name] = path
    if "template" not in files:
        if files:
            value, remedy = shown(entry["template_canonical"]), "add cloth.template"
            field, problem = "cloth.template_canonical", "there is no template it belongs to"
            found.append(Violation(DOCUMENT, field, value, problem, remedy))
        return None
    try:
        mesh = read_obj(files["template"], files.get("template_canonical"))
    except ClothTrackError as error:
        named = [name for name, path in files.items() if str(error).startswith(f"{path}: ")]
        file = entry[named[0] if named else "template"]
        found.append(violation_of(error, folder, file))
        return None
    size = float(np.ptp(mesh.vertices, axis=0).max())
    if not 0.01 <= size <= 10:
        problem, remedy = "implausible for a cloth (0.01 to 10 m)", "write the mesh in metres"
        found.append(Violation(entry["template"], "largest side", f"{size:g} m", problem, remedy))
    return mesh


def _optional(value: float | None) -> float | None:
    return None if value is None else float(value)
