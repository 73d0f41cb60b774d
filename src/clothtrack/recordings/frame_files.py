"""The files of each frame, named in the document or found by their conventional names."""

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np

from clothtrack.geometry.camera import Camera
from clothtrack.recordings import pictures
from clothtrack.recordings.recording import FARTHEST_MEDIAN_M, NEAREST_MEDIAN_M, Frame
from clothtrack.recordings.violation import Violations, shown

PictureKind = Literal["color", "depth", "mask"]
PICTURE_KINDS: tuple[PictureKind, ...] = ("color", "depth", "mask")

FileKind = Literal["color", "depth", "mask", "cloud"]
_FILE_KINDS: tuple[FileKind, ...] = (*PICTURE_KINDS, "cloud")


def conventional_name(kind: FileKind, frame: int, camera: str | None = None) -> str:
    """Return the file of a frame inside the recording; `camera` is None when there is only one."""
    if kind == "cloud":
        return f"cloud/{frame:06d}.npz"
    return f"{kind}/{frame:06d}.png" if camera is None else f"{kind}/{camera}/{frame:06d}.png"


def named_file(folder: Path, name: str, field: str, violations: Violations) -> Path | None:
    """Return the absolute path of a file that a field names; None if it leaves the folder."""
    written = PurePosixPath(name)
    if not (written.is_absolute() or ".." in written.parts or "\\" in name or "\0" in name):
        path = folder / written
        if path.resolve().is_relative_to(folder):
            return path
    remedy = "put the file inside and write a relative path with forward slashes"
    violations.add(field, shown(name), f"the path leads out of the recording; {remedy}")
    return None


def find_frames(
    folder: Path,
    entries: Sequence[Mapping[str, Any]],
    camera_names: Sequence[str],
    violations: Violations,
) -> tuple[Frame, ...]:
    """Return the frames of a document."""
    frames: list[Frame] = []
    for index, entry in enumerate(entries):
        field, time_s = f"frames[{index}]", entry["time_s"]
        if entry.get("index", index) != index:
            words = f"the frame stands at place {index}; sort the frames or drop the field"
            violations.add(f"{field}.index", shown(entry["index"]), words)
        if frames and time_s <= frames[-1].time_s:
            problem = f"not after that of frames[{index - 1}] ({frames[-1].time_s} s)"
            words = f"{problem}; sort the frames by time, or add what a clock was set back by"
            violations.add(f"{field}.time_s", shown(time_s), words)
        if entry.keys() & set(_FILE_KINDS):
            files = {kind: _named_files(folder, entry.get(kind, {}), f"{field}.{kind}",
                                        camera_names, violations)
                     for kind in _FILE_KINDS}  # fmt: skip
        else:
            files = {kind: _conventional_files(folder, index, kind, camera_names, violations)
                     for kind in _FILE_KINDS}  # fmt: skip
        cloud = next(iter(files.pop("cloud").values()), None)
        if not (files["depth"] or cloud or entry.keys() & {"depth", "cloud"}):
            words = "neither depth nor a cloud shows this frame; "
            violations.add(field, "", words + "add depth/ (or cloud/) files or drop the frame")
        frames.append(Frame(index, float(time_s), **files, cloud=cloud))
    return tuple(frames)


def check_pictures(
    folder: Path,
    frames: Sequence[Frame],
    cameras: Mapping[str, Camera],
    depth_units_m: Mapping[str, float],
    *,
    thorough: bool,
) -> Violations:
    """Return what is wrong with the files of the frames.

    The header and the last bytes of every picture are read, every mask, and the first depth
    picture of each camera; all others are decoded only when `thorough`.
    """
    violations = Violations()
    judged: set[str] = set()
    for frame in frames:
        for kind in PICTURE_KINDS:
            for name, path in getattr(frame, kind).items():
                first = kind == "depth" and name not in judged
                judged |= {name} if first else set()
                file = path.relative_to(folder).as_posix()
                with violations.of_errors(folder, file):
                    problem = _header_problem(path, kind, cameras.get(name))
                    if not problem and (thorough or first or kind == "mask"):
                        problem = _content_problem(path, kind, depth_units_m.get(name, 0.0))
                    if problem:
                        violations.add(*problem, file=file)
        if frame.cloud is not None:
            file = frame.cloud.relative_to(folder).as_posix()
            if not frame.cloud.is_file():
                words = "the file is missing; add the file or drop it from the recording"
                violations.add("", "", words, file=file)
            elif thorough:
                with violations.of_errors(folder, file):
                    pictures.read_cloud(frame.cloud)
    return violations


def _named_files(
    folder: Path,
    named: str | Mapping[str, str],
    field: str,
    camera_names: Sequence[str],
    violations: Violations,
) -> dict[str, Path]:
    if isinstance(named, str):
        if len(camera_names) > 1 and not field.endswith(".cloud"):
            names = ", ".join(camera_names)
            problem = f"one file, but there are {len(camera_names)} cameras ({names})"
            remedy = f'write {{"{camera_names[0]}": {shown(named)}}}'
            violations.add(field, shown(named), f"{problem}; {remedy}")
            return {}
        named = {camera_names[0]: named}
    paths: dict[str, Path] = {}
    for camera, name in named.items():
        if camera not in camera_names:
            words = f"no such camera; name one of {', '.join(camera_names)}"
            violations.add(field, shown(camera), words)
        elif (path := named_file(folder, name, field, violations)) is not None:
            paths[camera] = path
    return paths


def _conventional_files(
    folder: Path,
    index: int,
    kind: FileKind,
    camera_names: Sequence[str],
    violations: Violations,
) -> dict[str, Path]:
    paths = {}
    for camera in camera_names:
        name = conventional_name(kind, index, camera if len(camera_names) > 1 else None)
        path = folder / name
        # A folder of pictures must be complete; masks may show some frames only.
        is_there = path.is_file() if kind == "mask" else path.parent.is_dir()
        if is_there and named_file(folder, name, f"frames[{index}].{kind}", violations):
            paths[camera] = path
    return paths


def _header_problem(
    path: Path, kind: PictureKind, camera: Camera | None
) -> tuple[str, str, str] | None:
    header = pictures.read_header(path)
    if kind == "depth" and (header.bits, header.color_type) != (16, pictures.GRAY):
        remedy = "write depth as one 16-bit gray channel"
        return "bits", str(header.bits), f"{pictures.depth_problem(header)}; {remedy}"
    if camera and (header.width, header.height) != (camera.width, camera.height):
        problem = f"camera {camera.name!r} has {camera.width} x {camera.height}"
        remedy = "correct width and height (and the intrinsics) of the camera, or the picture"
        return "size", f"{header.width} x {header.height}", f"{problem}; {remedy}"
    return None


def _content_problem(path: Path, kind: PictureKind, unit_m: float) -> tuple[str, str, str] | None:
    if kind == "color":
        pictures.read_color(path)
        return None
    if kind == "mask":
        remedy = "paint the cloth white, or delete the mask: color is used then"
        words = f"no pixel of the cloth is marked; {remedy}"
        return None if pictures.read_mask(path).any() else ("the mask", "empty", words)
    depth = pictures.read_depth(path, unit_m or 1.0)
    measured = depth[depth > 0]
    if not measured.size:
        return "depth", "0 everywhere", "nothing was measured; record it again or drop it"
    median = float(np.median(measured))
    if not unit_m or NEAREST_MEDIAN_M <= median <= FARTHEST_MEDIAN_M:
        return None
    return (
        "median depth", f"{median:.3g} m", f"implausible with depth_unit_m = {unit_m:g} "
        f"(plausible: {NEAREST_MEDIAN_M} to {FARTHEST_MEDIAN_M} m); "
        "correct depth_unit_m of the camera in recording.json (0.001 for millimeters)",
    )  # fmt: skip
