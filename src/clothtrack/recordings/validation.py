"""Validation of a recording on disk, which reports every violation of the format."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.colors import NAMED_COLORS
from clothtrack.recordings.frame_files import check_pictures, find_frames, named_file
from clothtrack.recordings.picker_table import PICKER_FILE, read_picker_paths
from clothtrack.recordings.recording import (
    FARTHEST_MEDIAN_M,
    ClothDescription,
    Frame,
    ObservedRegion,
    PickAndPlace,
    PickerPath,
    Recording,
    Table,
    not_up,
)
from clothtrack.recordings.recording_file import load_document
from clothtrack.recordings.template_file import held_problem, read_obj
from clothtrack.recordings.violation import DOCUMENT, Violation, Violations, shown

_TIME_TOLERANCE_S = 1e-3


@dataclass(frozen=True, eq=False)
class CheckedRecording:
    """A recording with its violations.

    Attributes:
        recording: the recording; None when `violations` is not empty.
    """

    recording: Recording | None
    violations: tuple[Violation, ...]


def check_recording(folder: Path, *, thorough: bool = False) -> CheckedRecording:
    """Read a recording and collect everything that is wrong with it."""
    folder = folder.resolve()
    document, violations = load_document(folder)
    if document is None:
        return CheckedRecording(None, tuple(violations))
    check = _Check(folder, document)
    recording = check.recording(thorough=thorough)
    if check.violations:
        return CheckedRecording(None, tuple(check.violations))
    return CheckedRecording(recording, ())


class _Check:
    """A builder of a recording from a document that fulfills the schema; it notes violations.

    What it builds after a violation is only good for finding further ones.
    """

    def __init__(self, folder: Path, document: Mapping[str, Any]) -> None:
        self.violations = Violations()
        self._folder = folder
        self._document = document

    def recording(self, *, thorough: bool) -> Recording:
        """Return the recording; good for use only while `violations` is empty."""
        entries = self._document["cameras"]
        units = {entry["name"]: float(entry["depth_unit_m"]) for entry in entries
                 if "depth_unit_m" in entry}  # fmt: skip
        cameras = self._cameras()
        table = self._table()
        names = [entry["name"] for entry in entries]
        frames = find_frames(self._folder, self._document["frames"], names, self.violations)
        for place, name in enumerate(names):
            if name not in units and any(name in frame.depth for frame in frames):
                words = "missing, but the camera has depth; add it: 0.001 for millimeters"
                self.violations.add(f"cameras[{place}].depth_unit_m", "", words)
        paths = self._picker_paths(cameras)
        actions = self._actions(frames, paths)
        cloth = self._cloth(paths)
        self.violations += check_pictures(
            self._folder,
            frames,
            {camera.name: camera for camera in cameras},
            units,
            thorough=thorough,
        )
        observed = self._document.get("observed", {})
        lowest = observed.get("lowest_height_m")
        return Recording(
            folder=self._folder,
            cameras=tuple(cameras),
            depth_units_m=units,
            frames=frames,
            actions=actions,
            picker_paths=paths or {},
            table=table,
            cloth=cloth,
            observed=ObservedRegion(
                None if lowest is None else float(lowest),
                float(observed.get("tool_clearance_m", 0.0)),
            ),
            provenance=self._document.get("provenance", {}),
        )

    def _cameras(self) -> list[Camera]:
        cameras: dict[str, Camera] = {}
        names: set[str] = set()
        for place, entry in enumerate(self._document["cameras"]):
            field, name = f"cameras[{place}]", entry["name"]
            if name in names:
                words = "two cameras of this name; name each camera differently"
                self.violations.add(f"{field}.name", shown(name), words)
                continue
            names.add(name)
            pose = np.array(entry.get("world_from_camera", np.eye(4)), dtype=np.float64)
            lens = (float(entry[key]) for key in ("fx", "fy", "cx", "cy"))
            with self.violations.of_errors(Path(), DOCUMENT, field):
                cameras[name] = Camera(name, entry["width"], entry["height"], *lens, pose)
                self._check_lens(cameras[name], field)
        return list(cameras.values())

    def _check_lens(self, camera: Camera, field: str) -> None:
        for name, focal, side in (("fx", camera.fx, "width"), ("fy", camera.fy, "height")):
            size = getattr(camera, side)
            least, most = 0.15 * size, 20 * size
            if not least <= focal <= most:
                problem = f"implausible for a {side} of {size} pixels ({least:g} to {most})"
                words = f"{problem}; write the focal length in pixels of this picture size"
                self.violations.add(f"{field}.{name}", f"{focal:g}", words)
                return
        if words := _swapped(camera):
            self.violations.add(f"{field}.cx, cy", f"({camera.cx:g}, {camera.cy:g})", words)
        elif not 0.75 <= (ratio := camera.fx / camera.fy) <= 4 / 3:
            remedy = "were intrinsics of another picture size, or cx and cy, written there?"
            words = f"pixels of a camera are nearly square; {remedy}"
            self.violations.add(f"{field}.fx / fy", f"{ratio:.3g}", words)

    def _table(self) -> Table | None:
        entry = self._document.get("table")
        if entry is None:
            return None
        normal = np.array(entry["normal"], dtype=np.float64)
        if words := not_up(normal):
            self.violations.add("table.normal", shown(entry["normal"]), words)
            return None
        return Table(np.array(entry["point"], dtype=np.float64), normal / np.linalg.norm(normal))

    def _picker_paths(self, cameras: list[Camera]) -> dict[str, PickerPath] | None:
        """Return the path per picker; None where they cannot be read."""
        file = self._folder / PICKER_FILE
        if not file.exists():
            return {}
        if not file.resolve().is_relative_to(self._folder):
            words = "the link leads out of the recording; put the file itself inside"
            self.violations.add("", "", words, file=PICKER_FILE)
            return None
        paths = None
        with self.violations.of_errors(self._folder, PICKER_FILE):
            paths = read_picker_paths(file)
        for name, path in (paths or {}).items() if cameras else ():
            with np.errstate(over="ignore"):  # the distance may overflow
                distances = [
                    np.linalg.norm(path.positions - camera.position, axis=1) for camera in cameras
                ]
            nearest = np.min(distances, axis=0)
            far = np.flatnonzero(nearest > FARTHEST_MEDIAN_M)
            if len(far):  # not meters, most likely
                x, y, z = path.positions[far[0]]
                field = f"x_m, y_m, z_m of picker {name!r} at {path.time_s[far[0]]:g} s"
                words = (
                    f"{nearest[far[0]]:.3g} m from the nearest camera (at most "
                    f"{FARTHEST_MEDIAN_M:g} m); write meters, in the world frame of the cameras "
                    f"in {DOCUMENT}"
                )
                self.violations.add(field, f"({x:g}, {y:g}, {z:g})", words, file=PICKER_FILE)
        return paths

    def _actions(
        self, frames: tuple[Frame, ...], paths: Mapping[str, PickerPath] | None
    ) -> tuple[PickAndPlace, ...]:
        actions: list[PickAndPlace] = []
        for place, entry in enumerate(self._document.get("actions", [])):
            field = f"actions[{place}]"
            first, last = entry["first_frame"], entry["last_frame"]
            words = ""
            if last >= len(frames):
                words = f"the last frame is {len(frames) - 1}; name a frame that exists"
            elif last <= first:
                words = f"not after first_frame ({first}); an action takes at least two frames"
            if words:
                self.violations.add(f"{field}.last_frame", str(last), words)
                continue
            previous = actions[-1].last_frame if actions else 0
            if first < previous:
                problem = f"overlaps the action before it, which ends at frame {previous}"
                words = f"{problem}; let actions follow each other (they may share one frame)"
                self.violations.add(f"{field}.first_frame", str(first), words)
            for name in entry["pickers"] if paths is not None else ():
                times = frames[first].time_s, frames[last].time_s
                self._check_covered(field, name, times, paths or {})
            actions.append(PickAndPlace(first, last, tuple(entry["pickers"])))
        return tuple(actions)

    def _check_covered(
        self, field: str, name: str, times: tuple[float, float], paths: Mapping[str, PickerPath]
    ) -> None:
        if name not in paths:
            problem = f"no such picker in {PICKER_FILE} (there: {', '.join(paths) or 'none'})"
            words = f"{problem}; correct the name or add the picker's path"
            self.violations.add(f"{field}.pickers", shown(name), words)
            return
        start, end = paths[name].time_s[[0, -1]].tolist()
        if start > times[0] + _TIME_TOLERANCE_S or end < times[1] - _TIME_TOLERANCE_S:
            words = (
                f"it does not cover {field} of {DOCUMENT}, which lasts from {times[0]:g} to "
                f"{times[1]:g} s; record the whole path, with the clock of the frames"
            )
            field, value = f"time_s of picker {name!r}", f"{start:g} to {end:g}"
            self.violations.add(field, value, words, file=PICKER_FILE)

    def _cloth(self, paths: Mapping[str, PickerPath] | None) -> ClothDescription:
        entry = self._document.get("cloth", {})
        color = entry.get("color")
        if color is not None and color.lower() not in NAMED_COLORS:
            remedy = f"choose from {', '.join(NAMED_COLORS)}, or leave it out"
            self.violations.add("cloth.color", shown(color), f"an unknown color name; {remedy}")
        template = self._template(entry)
        held = {name: np.array(ids, dtype=np.int64) for name, ids in
                entry.get("held_vertices", {}).items()}  # fmt: skip
        for name, vertices in held.items():
            problems = []
            if paths is not None and name not in paths:
                problems.append(f"no such picker; add its path to {PICKER_FILE}")
            if entry.get("template") is None:
                problems.append("there is no template; add cloth.template")
            elif template and (problem := held_problem(vertices, template.vertex_count)):
                remedy = "vertices are counted from 0 (OBJ files count from 1)"
                problems.append(f"{problem}; {remedy}")
            for words in problems:
                value = shown(vertices.tolist())
                self.violations.add(f"cloth.held_vertices.{name}", value, words)
        size = entry.get("size_m")
        return ClothDescription(
            kind=entry.get("kind", "other"),
            color=None if color is None else color.lower(),
            size_m=None if size is None else (float(size[0]), float(size[1])),
            template=template,
            held_vertices=held,
            grasp_uncertainty_m=float(entry.get("grasp_uncertainty_m", 0.0)),
        )

    def _template(self, entry: Mapping[str, Any]) -> ClothMesh | None:
        files: dict[str, Path] = {}
        for name in ("template", "template_canonical"):
            if entry.get(name) is not None:
                path = named_file(self._folder, entry[name], f"cloth.{name}", self.violations)
                if path is None:
                    return None
                files[name] = path
        if "template" not in files:
            if files:
                words = "there is no template it belongs to; add cloth.template"
                value = shown(entry["template_canonical"])
                self.violations.add("cloth.template_canonical", value, words)
            return None
        mesh = None
        with self.violations.of_errors(self._folder, entry["template"]):
            mesh = read_obj(files["template"], files.get("template_canonical"))
        size = 1.0 if mesh is None else float(np.ptp(mesh.vertices, axis=0).max())
        if not 0.01 <= size <= 10:
            words = "implausible for a cloth (0.01 to 10 m); write the mesh in meters"
            file = entry["template"]
            self.violations.add("largest side", f"{size:g} m", words, file=file)
        return mesh


def _swapped(camera: Camera) -> str:
    """Return which intrinsics are swapped, and the remedy; empty if none are."""
    middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    center, focal = np.array([camera.cx, camera.cy]), np.array([camera.fx, camera.fy])
    off, swapped_off, focal_off = (
        float(np.abs(pair - middle).max()) for pair in (center, center[::-1], focal)
    )
    if off <= 0.1 * camera.width:
        return ""
    if swapped_off < 0.25 * off:
        problem = "far from the middle of the picture, and swapped they are not"
        return f"{problem}; cx is the column and cy the row: swap them"
    if focal_off < 0.25 * off and 0.75 * camera.cy <= camera.cx <= 4 / 3 * camera.cy:
        problem = "far from the middle of the picture, and fx, fy are not"
        return f"{problem}; were fx, fy and cx, cy swapped? The focal lengths are fx and fy"
    return ""
