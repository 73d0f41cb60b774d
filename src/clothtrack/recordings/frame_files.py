"""Which files show each frame: named in the document or found by their conventional names."""

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings import pictures
from clothtrack.recordings.recording import Frame
from clothtrack.recordings.recording_file import DOCUMENT
from clothtrack.recordings.violation import Violation, shown, violation_of

PictureKind = Literal["color", "depth", "mask"]
PICTURE_KINDS: tuple[PictureKind, ...] = ("color", "depth", "mask")
# No cloth is recorded from nearer or from farther [m]; a wrong unit is off by a factor of ten.
NEAREST_MEDIAN_M, FARTHEST_MEDIAN_M = 0.05, 20.0


def conventional_name(
    kind: Literal["color", "depth", "mask", "cloud"], frame: int, camera: str | None = None
) -> str:
    """File of a frame inside the recording; `camera` is None when there is only one."""
    if kind == "cloud":
        return f"cloud/{frame:06d}.npz"
    return f"{kind}/{frame:06d}.png" if camera is None else f"{kind}/{camera}/{frame:06d}.png"


def inside(folder: Path, name: str) -> Path | None:
    """Absolute path of a file that a document names; None when it leads out of the folder."""
    written = PurePosixPath(name)
    if written.is_absolute() or ".." in written.parts or "\\" in name or "\0" in name:
        return None
    path = folder / written
    return path if path.resolve().is_relative_to(folder) else None


def find_frames(
    folder: Path, entries: Sequence[Mapping[str, Any]], camera_names: Sequence[str]
) -> tuple[tuple[Frame, ...], list[Violation]]:
    """The frames of a document and what is wrong with the way it names their files.

    Args:
        folder: the recording's folder, resolved.
        entries: `frames` of the document, fulfilling the schema.
        camera_names: every camera, in the document's order.
    """
    found: list[Violation] = []
    frames: list[Frame] = []
    for index, entry in enumerate(entries):
        if entry.get("index", index) != index:
            found.append(
                Violation(
                    DOCUMENT, f"frames[{index}].index", shown(entry["index"]),
                    f"the frame stands at place {index}", "sort the frames or drop the field",
                )
            )  # fmt: skip
        if frames and entry["time_s"] <= frames[-1].time_s:
            found.append(
                Violation(
                    DOCUMENT, f"frames[{index}].time_s", shown(entry["time_s"]),
                    f"not after the frame before it ({frames[-1].time_s} s)",
                    "sort the frames by time and drop doubles",
                )
            )  # fmt: skip
        paths = {kind: _paths(folder, entry, index, kind, camera_names, found=found)
                 for kind in PICTURE_KINDS}  # fmt: skip
        cloud = _cloud(folder, entry, index, found)
        frame = Frame(index, float(entry["time_s"]), **paths, cloud=cloud)
        if not (frame.depth or cloud or entry.keys() & {"depth", "cloud"}):
            found.append(
                Violation(
                    DOCUMENT, f"frames[{index}]", "", "neither depth nor a cloud shows this frame",
                    "add depth/ (or cloud/) files or drop the frame",
                )
            )  # fmt: skip
        frames.append(frame)
    return tuple(frames), found


def check_pictures(
    folder: Path,
    frames: Sequence[Frame],
    cameras: Mapping[str, Camera],
    depth_units_m: Mapping[str, float],
    *,
    thorough: bool,
) -> list[Violation]:
    """What is wrong with the files of the frames.

    The header and the last bytes of every picture are read, every mask, and the first depth
    picture of each camera; all others are decoded only when `thorough`.
    """
    found: list[Violation] = []
    judged: set[str] = set()
    for frame in frames:
        for kind in PICTURE_KINDS:
            for name, path in getattr(frame, kind).items():
                first = kind == "depth" and name not in judged
                judged |= {name} if first else set()
                try:
                    problem = _header_problem(path, kind, cameras.get(name))
                    if not problem and (thorough or first or kind == "mask"):
                        problem = _content_problem(path, kind, depth_units_m.get(name, 0.0))
                except InvalidRecordingError as error:
                    found.append(violation_of(error, folder, _relative(folder, path)))
                else:
                    if problem:
                        found.append(Violation(_relative(folder, path), *problem))
        if frame.cloud is not None:
            found += _cloud_problems(folder, frame.cloud, thorough=thorough)
    return found


def _paths(
    folder: Path,
    entry: Mapping[str, Any],
    index: int,
    kind: PictureKind,
    camera_names: Sequence[str],
    *,
    found: list[Violation],
) -> dict[str, Path]:
    if not entry.keys() & {*PICTURE_KINDS, "cloud"}:
        return _conventional_paths(folder, index, kind, camera_names)
    named = entry.get(kind, {})
    field = f"frames[{index}].{kind}"
    if isinstance(named, str):
        if len(camera_names) > 1:
            names = ", ".join(camera_names)
            problem = f"one file, but there are {len(camera_names)} cameras ({names})"
            remedy = f'write {{"{camera_names[0]}": {shown(named)}}}'
            found.append(Violation(DOCUMENT, field, shown(named), problem, remedy))
            return {}
        named = {camera_names[0]: named}
    paths: dict[str, Path] = {}
    for camera, name in named.items():
        path = inside(folder, name)
        if camera not in camera_names:
            remedy = f"name one of {', '.join(camera_names)}"
            found.append(Violation(DOCUMENT, field, shown(camera), "no such camera", remedy))
        elif path is None:
            found.append(_leads_out(field, name))
        else:
            paths[camera] = path
    return paths


def _conventional_paths(
    folder: Path, index: int, kind: PictureKind, camera_names: Sequence[str]
) -> dict[str, Path]:
    paths = {}
    for name in camera_names:
        camera = name if len(camera_names) > 1 else None
        path = folder / conventional_name(kind, index, camera)
        # A folder of pictures must be complete; masks may show some frames only.
        if path.is_file() if kind == "mask" else path.parent.is_dir():
            paths[name] = path
    return paths


def _cloud(
    folder: Path, entry: Mapping[str, Any], index: int, found: list[Violation]
) -> Path | None:
    if not entry.keys() & {*PICTURE_KINDS, "cloud"}:
        path = folder / conventional_name("cloud", index)
        return path if path.parent.is_dir() else None
    if "cloud" not in entry:
        return None
    path = inside(folder, entry["cloud"])
    if path is None:
        found.append(_leads_out(f"frames[{index}].cloud", entry["cloud"]))
    return path


def _leads_out(field: str, name: str) -> Violation:
    problem = "the path leads out of the recording"
    remedy = "put the file inside and write a relative path with forward slashes"
    return Violation(DOCUMENT, field, shown(name), problem, remedy)


def _header_problem(
    path: Path, kind: PictureKind, camera: Camera | None
) -> tuple[str, str, str, str] | None:
    header = pictures.read_header(path)
    if kind == "depth" and (header.bits, header.color_type) != (16, pictures.GREY):
        return (
            "bits", str(header.bits), pictures.depth_problem(header),
            "write depth as one 16-bit grey channel",
        )  # fmt: skip
    if camera and (header.width, header.height) != (camera.width, camera.height):
        return (
            "size", f"{header.width} x {header.height}",
            f"camera {camera.name!r} has {camera.width} x {camera.height}",
            "correct width and height (and the intrinsics) of the camera, or the picture",
        )  # fmt: skip
    return None


def _content_problem(
    path: Path, kind: PictureKind, unit_m: float
) -> tuple[str, str, str, str] | None:
    if kind == "color":
        pictures.read_color(path)
    elif kind == "mask":
        if not pictures.read_mask(path).any():
            remedy = "paint the cloth white, or delete the mask: colour is used then"
            return "the mask", "empty", "no pixel of the cloth is marked", remedy
    else:
        depth = pictures.read_depth(path, unit_m or 1.0)
        measured = depth[depth > 0]
        if not measured.size:
            return "depth", "0 everywhere", "nothing was measured", "record it again or drop it"
        median = float(np.median(measured))
        if unit_m and not NEAREST_MEDIAN_M <= median <= FARTHEST_MEDIAN_M:
            return (
                "median depth", f"{median:.3g} m",
                f"implausible with depth_unit_m = {unit_m:g} "
                f"(plausible: {NEAREST_MEDIAN_M} to {FARTHEST_MEDIAN_M} m)",
                "correct depth_unit_m of the camera in recording.json (0.001 for millimetres)",
            )  # fmt: skip
    return None


def _cloud_problems(folder: Path, path: Path, *, thorough: bool) -> list[Violation]:
    file = _relative(folder, path)
    if not path.is_file():
        remedy = "add the file or drop it from the recording"
        return [Violation(file, "", "", "the file is missing", remedy)]
    if thorough:
        try:
            pictures.read_cloud(path)
        except InvalidRecordingError as error:
            return [violation_of(error, folder, file)]
    return []


def _relative(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix()
