"""A recording as plain arrays in memory: read, changed in any way, and written.

It is written without the package's writer, which would refuse the content of a wrong recording.
Errors should be refused, or not, at the same point as for a user's own folder.
"""

import copy
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

CLOSED = 4
"""Column of a picker's samples that says whether it is closed; before it: time, x, y, z."""


Part = Any
"""An array, or None where the recording lacks it: a kind of change names what it needs."""


@dataclass
class RecordingData:
    """A recording with at most one camera that takes pictures, and the truth beside it.

    Attributes:
        document: recording.json, without the names of files; `frames` has the times.
        color: red first, (frames, height, width, 3) of 8 bits; None without color.
        depth: in the camera's `depth_unit_m`, (frames, height, width) of 16 bits; None: clouds.
        mask: the cloth, (frames, height, width); None without masks.
        clouds: points in the world [m] of each frame; empty with depth.
        picker: per name, (samples, 5): time [s], x, y, z [m], closed.
        vertices: of the template [m]; None without one.
        faces: of the template.
        canonical: of the template's vertices [m], or None.
        truth: true vertices in the true world [m], (moments, vertices, 3); no file of the recording
            holds them.
        truth_faces: triangles of the truth.
        truth_canonical: canonical coordinates of the true vertices [m].
        moments: which moment of the truth the clock of each frame stands for.
        facts: what else the scorer must know.
    """

    document: dict[str, Any]
    color: Part = None
    depth: Part = None
    mask: Part = None
    clouds: list[np.ndarray] = field(default_factory=list)
    picker: dict[str, np.ndarray] = field(default_factory=dict)
    vertices: Part = None
    faces: Part = None
    canonical: Part = None
    truth: Part = None
    truth_faces: Part = None
    truth_canonical: Part = None
    moments: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def camera(self) -> dict[str, Any]:
        """The first camera of the document."""
        return self.document["cameras"][0]

    @property
    def pose(self) -> np.ndarray:
        """World from camera of the first camera."""
        return np.array(self.camera.get("world_from_camera", np.eye(4)), np.float64)

    @pose.setter
    def pose(self, pose: np.ndarray) -> None:
        self.camera["world_from_camera"] = pose.tolist()

    @property
    def times(self) -> np.ndarray:
        """Time of each frame [s]."""
        return np.array([frame["time_s"] for frame in self.document["frames"]])

    @times.setter
    def times(self, times: np.ndarray) -> None:
        self.document["frames"] = [{"time_s": float(time_s)} for time_s in times]

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.document["frames"])

    @property
    def scale(self) -> float:
        """Pixels of this picture for one of a picture 640 pixels wide."""
        return self.camera["width"] / 640.0

    def carried(self) -> tuple[int, int]:
        """Return first and last frame of the first action in which a picker is closed."""
        action = self.document["actions"][0]
        frames = np.arange(action["first_frame"], action["last_frame"] + 1)
        closed = np.zeros(len(frames), bool)
        for name in action["pickers"]:
            samples = self.picker[name]
            place = np.searchsorted(samples[:, 0], self.times[frames] + 1e-9, side="right") - 1
            closed |= samples[np.maximum(place, 0), CLOSED] > 0
        held = frames[closed] if closed.any() else frames
        return int(held[0]), int(held[-1])

    def copied(self) -> "RecordingData":
        """Return a copy whose every part may be changed."""
        return copy.deepcopy(self)

    def take(self, frames: np.ndarray) -> None:
        """Keep these frames only, in this order; times and moments go with them.

        An action keeps what is left of it.
        """
        frames = np.asarray(frames)
        for name in ("color", "depth", "mask"):
            pictures = getattr(self, name)
            if pictures is not None:
                setattr(self, name, pictures[frames])
        self.clouds = [self.clouds[frame] for frame in frames] if self.clouds else []
        self.times, self.moments = self.times[frames], self.moments[frames]
        for action in self.document["actions"]:
            inside = np.flatnonzero(
                (frames >= action["first_frame"]) & (frames <= action["last_frame"])
            )
            action["first_frame"], action["last_frame"] = int(inside[0]), int(inside[-1])

    def write(self, folder: Path) -> Path:
        """Write the folder as docs/data_format.md shows it, whatever it holds."""
        folder.mkdir(parents=True)
        document = copy.deepcopy(self.document)
        for name in ("color", "depth", "mask"):
            pictures = getattr(self, name)
            if pictures is None:
                continue
            (folder / name).mkdir()
            for number, picture in enumerate(pictures):
                stored = picture[..., ::-1] if name == "color" else picture
                stored = stored.astype(np.uint8) * 255 if name == "mask" else stored
                file = folder / name / f"{number:06d}.png"
                cv2.imwrite(str(file), stored, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        if self.clouds:
            (folder / "cloud").mkdir()
            for number, cloud in enumerate(self.clouds):
                np.savez(folder / "cloud" / f"{number:06d}.npz", points=cloud)
        if self.picker:
            _write_picker(self.picker, folder / "picker.csv")
        if self.vertices is not None and self.faces is not None:
            document["cloth"]["template"] = "template.obj"
            lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in self.vertices.tolist()]
            lines += [f"f {a} {b} {c}\n" for a, b, c in (self.faces + 1).tolist()]
            (folder / "template.obj").write_text("".join(lines), "utf-8")
            if self.canonical is not None:
                document["cloth"]["template_canonical"] = "template_canonical.csv"
                rows = [f"{x!r},{y!r},{z!r}\n" for x, y, z in self.canonical.tolist()]
                (folder / "template_canonical.csv").write_text("x_m,y_m,z_m\n" + "".join(rows))
        (folder / "recording.json").write_text(json.dumps(document), "utf-8")
        return folder

    def save(self, file: Path) -> None:
        """Write everything, the truth too, to one NPZ file."""
        arrays = {
            name: getattr(self, name)
            for name in (*_ARRAYS, "moments")
            if getattr(self, name) is not None
        }
        arrays |= {f"picker_{name}": samples for name, samples in self.picker.items()}
        arrays |= {f"cloud_{number:06d}": cloud for number, cloud in enumerate(self.clouds)}
        text = json.dumps({"document": self.document, "facts": self.facts})
        unfinished = file.with_suffix(".partial.npz")
        np.savez(unfinished, text=np.array(text), **arrays)
        unfinished.rename(file)

    @classmethod
    def load(cls, file: Path) -> "RecordingData":
        """Return what `save` has written."""
        with np.load(file) as stored:
            arrays = {name: stored[name] for name in stored.files}
        text = json.loads(str(arrays.pop("text")))
        picker = {n[7:]: arrays.pop(n) for n in list(arrays) if n.startswith("picker_")}
        clouds = [arrays.pop(n) for n in sorted(arrays) if n.startswith("cloud_")]
        return cls(text["document"], picker=picker, clouds=clouds, facts=text["facts"], **arrays)


_ARRAYS = (
    "color", "depth", "mask", "vertices", "faces", "canonical", "truth", "truth_faces",
    "truth_canonical",
)  # fmt: skip


def _write_picker(picker: dict[str, np.ndarray], file: Path) -> None:
    lines = ["time_s,picker,x_m,y_m,z_m,closed\n"]
    for name, samples in picker.items():
        for time_s, x, y, z, closed in samples.tolist():
            lines.append(f"{time_s!r},{name},{x!r},{y!r},{z!r},{int(closed)}\n")
    file.write_text("".join(lines), "utf-8")


def _read_picker(file: Path) -> dict[str, np.ndarray]:
    samples: dict[str, list[list[float]]] = {}
    for line in file.read_text("utf-8").splitlines()[1:]:
        time_s, name, *rest = line.split(",")
        samples.setdefault(name, []).append([float(word) for word in (time_s, *rest)])
    return {name: np.array(rows) for name, rows in samples.items()}


def read_folder(folder: Path) -> RecordingData:
    """Return a recording with one camera, or clouds, as it lies on disk; without a truth."""
    document = json.loads((folder / "recording.json").read_text("utf-8"))
    frames, cloth = document["frames"], document["cloth"]
    data = RecordingData(document, moments=np.arange(len(frames)))

    def pictures(name: str) -> list[np.ndarray]:
        files = [folder / frame[name] for frame in frames if name in frame]
        files = files or sorted((folder / name).glob("*.png"))
        return [np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED)) for file in files]

    if color := pictures("color"):
        data.color = np.stack(color)[..., ::-1].copy()
    if depth := pictures("depth"):
        data.depth = np.stack(depth)
    if mask := pictures("mask"):
        data.mask = np.stack(mask) > 0
    for frame in frames:
        if "cloud" in frame:
            with np.load(folder / frame["cloud"]) as stored:
                data.clouds.append(stored["points"].astype(np.float64))
    if (folder / "picker.csv").exists():
        data.picker = _read_picker(folder / "picker.csv")
    if "template" in cloth:
        rows = [line.split() for line in (folder / cloth.pop("template")).read_text().splitlines()]
        data.vertices = np.array([row[1:4] for row in rows if row[0] == "v"], np.float64)
        data.faces = np.array([row[1:4] for row in rows if row[0] == "f"], np.int64) - 1
    if "template_canonical" in cloth:
        rows = (folder / cloth.pop("template_canonical")).read_text().splitlines()[1:]
        data.canonical = np.array([row.split(",") for row in rows], np.float64)
    # Only the times of the frames stay: files have their conventional names again.
    data.times = data.times
    return data
