"""Right recordings, each corrupted by one typical geometry error of new users.

A corrupted recording is a copy on disk with the pictures of the right one.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.recordings import Recording

LATE_S, EARLY_S = 0.6, 0.4
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])

Document = dict[str, Any]
Samples = list[dict[str, str]]


@dataclass(frozen=True)
class Kind:
    """One way to be wrong.

    Attributes:
        name: of the folder of copies.
        text: for a person.
        field: what is wrong, as a finding should name it.
        document: changes recording.json.
        samples: changes picker.csv, row by row.
        vertices: changes the template [m].
    """

    name: str
    text: str
    field: str
    document: Callable[[Document], None] | None = None
    samples: Callable[[Samples], Samples] | None = None
    vertices: Callable[[np.ndarray], np.ndarray] | None = None


def spoilt(recording: Recording, kind: Kind, folder: Path) -> Path:
    """Write the copy of a recording that is wrong in this way; its folder."""
    shutil.copytree(recording.folder, folder)
    document = json.loads((folder / "recording.json").read_text("utf-8"))
    if kind.vertices is not None:
        _change_template(folder / document["cloth"]["template"], kind.vertices)
    if kind.samples is not None:
        _change_samples(folder / "picker.csv", kind.samples)
    if kind.document is not None:
        kind.document(document)
        (folder / "recording.json").write_text(json.dumps(document), "utf-8")
    return folder


def _change_template(path: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    lines = path.read_text("utf-8").splitlines()
    places = [number for number, line in enumerate(lines) if line.startswith("v ")]
    vertices = np.array([[float(word) for word in lines[number].split()[1:4]] for number in places])
    for number, vertex in zip(places, change(vertices), strict=True):
        lines[number] = "v " + " ".join(repr(value) for value in vertex.tolist())
    path.write_text("\n".join(lines) + "\n", "utf-8")


def _change_samples(path: Path, change: Callable[[Samples], Samples]) -> None:
    head, *rows = path.read_text("utf-8").splitlines()
    names = head.split(",")
    changed = change([dict(zip(names, row.split(","), strict=True)) for row in rows])
    text = [head, *(",".join(row[name] for name in names) for row in changed)]
    path.write_text("\n".join(text) + "\n", "utf-8")


def _posed(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Document], None]:
    def document(content: Document) -> None:
        for camera in content["cameras"]:
            pose = change(np.array(camera["world_from_camera"], np.float64))
            camera["world_from_camera"] = pose.tolist()

    return document


def _tilted(degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    angle = np.radians(degrees)
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return lambda pose: pose @ turn


def _raised(pose: np.ndarray) -> np.ndarray:
    pose[2, 3] += 0.1
    return pose


def _scaled_camera(field: str, factor: float) -> Callable[[Document], None]:
    def document(content: Document) -> None:
        for camera in content["cameras"]:
            camera[field] *= factor

    return document


def _sized(width: float, length: float) -> Callable[[Document], None]:
    def document(content: Document) -> None:
        size = content["cloth"]["size_m"]
        content["cloth"]["size_m"] = [size[0] * width, size[1] * length]

    return document


def _wide_lens(content: Document) -> None:
    """The focal lengths of a picture half as large again, as a scaled picture has them."""
    _scaled_camera("fx", 1.5)(content)
    _scaled_camera("fy", 1.5)(content)


def _begun_late(content: Document) -> None:
    """Begins in the middle of the first action, the cloth in the air, and has no template."""
    action = content["actions"][0]
    first = (action["first_frame"] + action["last_frame"]) // 2
    content["frames"] = content["frames"][first:]
    for number, frame in enumerate(content["frames"]):
        frame["index"] = number
    for action in content["actions"]:
        action["first_frame"] = max(action["first_frame"] - first, 0)
        action["last_frame"] -= first
    for name in ("template", "template_canonical", "held_vertices"):
        content["cloth"].pop(name, None)


def _moved(axis: str, by_m: float) -> Callable[[Samples], Samples]:
    def samples(rows: Samples) -> Samples:
        return [{**row, axis: repr(float(row[axis]) + by_m)} for row in rows]

    return samples


def _opened_and_closed(rows: Samples) -> Samples:
    return [{**row, "closed": "0" if int(row["closed"]) else "1"} for row in rows]


def _shifted(by_s: float) -> Callable[[Samples], Samples]:
    """The picker's clock differs; its path goes on at rest, so that it covers the actions."""

    def samples(rows: Samples) -> Samples:
        moved = [{**row, "time_s": repr(float(row["time_s"]) + by_s)} for row in rows]
        before = [{**moved[0], "time_s": rows[0]["time_s"]}] if by_s > 0 else []
        after = [{**moved[-1], "time_s": rows[-1]["time_s"]}] if by_s < 0 else []
        return [*before, *moved, *after]

    return samples


_POSE = "world_from_camera"
_UNIT = "depth_unit_m"
KINDS: tuple[Kind, ...] = (
    Kind("inverted", "camera pose inverted", _POSE, _posed(np.linalg.inv)),
    Kind("opengl", "camera pose with y up, z backward", _POSE, _posed(lambda pose: pose @ _FLIP)),
    Kind("tilted_away", "camera tilted away by 30 degrees", _POSE, _posed(_tilted(30.0))),
    Kind("tilted", "camera tilted by 5 degrees", _POSE, _posed(_tilted(5.0))),
    Kind("raised", "camera 0.1 m too high", _POSE, _posed(_raised)),
    Kind("unit_10", "depth unit 10 times as large", _UNIT, _scaled_camera(_UNIT, 10.0)),
    Kind("unit_01", "depth unit a tenth", _UNIT, _scaled_camera(_UNIT, 0.1)),
    Kind("unit_1000", "depth unit 1,000 times as large", _UNIT, _scaled_camera(_UNIT, 1e3)),
    Kind("unit_0001", "depth unit a thousandth", _UNIT, _scaled_camera(_UNIT, 1e-3)),
    Kind("lens", "fx and fy of another picture size", "fx", _wide_lens),
    Kind("size_2", "size: twice as long", "size_m", _sized(1.0, 2.0)),
    Kind("size_08", "size: a fifth too small", "size_m", _sized(0.8, 0.8)),
    Kind("template_far", "template 0.5 m beside", "template", vertices=lambda v: v + (0.5, 0, 0)),
    Kind("template_near", "template 0.1 m beside", "template", vertices=lambda v: v + (0, 0.1, 0)),
    Kind("template_large", "template 1.3 times as large", "template", vertices=lambda v: 1.3 * v),
    Kind("folded", "first frame not flat, no template", "frames[0]", _begun_late),
    Kind("picker_beside", "picker 0.1 m beside", "x_m", samples=_moved("x_m", 0.1)),
    Kind("picker_high", "picker 0.08 m too high", "z_m", samples=_moved("z_m", 0.08)),
    Kind("late", "picker's clock 0.6 s late", "time_s", samples=_shifted(LATE_S)),
    Kind("early", "picker's clock 0.4 s early", "time_s", samples=_shifted(-EARLY_S)),
)
"""Each is wrong in one field of the recording."""
