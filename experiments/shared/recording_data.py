"""A recording as plain arrays in memory: changed in any way, and written with its mistakes.

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

from clothtrack.recordings.pictures import read_color
from clothtrack.recordings.store import read_recording

CLOSED = 4
"""Column of a picker's samples that says whether it is closed; before it: time, x, y, z."""

PICTURES = ("color", "depth", "mask")


@dataclass
class RecordingData:
    """A recording of one camera, and the truth beside it.

    Attributes:
        document: recording.json, without the names of files; `frames` has the times.
        color: red first, (frames, height, width, 3) of 8 bits.
        depth: in the camera's `depth_unit_m`, (frames, height, width) of 16 bits.
        picker: per name, (samples, 5): time [s], x, y, z [m], closed.
        truth: true vertices in the true world [m], (moments, vertices, 3), in no file.
        moments: which moment of the truth the clock of each frame stands for.
    """

    document: dict[str, Any]
    color: Any = None
    depth: Any = None
    mask: Any = None
    picker: dict[str, np.ndarray] = field(default_factory=dict)
    vertices: Any = None
    faces: Any = None
    canonical: Any = None
    truth: Any = None
    truth_faces: Any = None
    truth_canonical: Any = None
    moments: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def camera(self) -> dict[str, Any]:
        """The camera of the document."""
        return self.document["cameras"][0]

    @property
    def pose(self) -> np.ndarray:
        """World from camera."""
        return np.array(self.camera["world_from_camera"], np.float64)

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

    def reordered(self, frames: np.ndarray, names: tuple[str, ...] = PICTURES) -> None:
        """Take the pictures of these frames; nothing else goes with them."""
        for name in names:
            if getattr(self, name) is not None:
                setattr(self, name, getattr(self, name)[frames])

    def take(self, frames: np.ndarray) -> None:
        """Keep these frames only, with times and moments; an action keeps what is left of it."""
        frames = np.asarray(frames)
        self.reordered(frames)
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
        for name in PICTURES:
            if getattr(self, name) is None:
                continue
            (folder / name).mkdir()
            for number, picture in enumerate(getattr(self, name)):
                stored = picture[..., ::-1] if name == "color" else picture
                stored = stored.astype(np.uint8) * 255 if name == "mask" else stored
                file = folder / name / f"{number:06d}.png"
                cv2.imwrite(str(file), stored, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        lines = ["time_s,picker,x_m,y_m,z_m,closed\n"]
        for name, samples in self.picker.items():
            for time_s, x, y, z, closed in samples.tolist():
                lines.append(f"{time_s!r},{name},{x!r},{y!r},{z!r},{int(closed)}\n")
        (folder / "picker.csv").write_text("".join(lines), "utf-8")
        if self.vertices is not None:
            document["cloth"]["template"] = "template.obj"
            lines = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in self.vertices.tolist()]
            lines += [f"f {a} {b} {c}\n" for a, b, c in (self.faces + 1).tolist()]
            (folder / "template.obj").write_text("".join(lines), "utf-8")
            document["cloth"]["template_canonical"] = "template_canonical.csv"
            rows = [f"{x!r},{y!r},{z!r}\n" for x, y, z in self.canonical.tolist()]
            (folder / "template_canonical.csv").write_text("x_m,y_m,z_m\n" + "".join(rows))
        (folder / "recording.json").write_text(json.dumps(document), "utf-8")
        return folder


def read_simulated(folder: Path, truth: Path) -> RecordingData:
    """Return a recording of the simulated world with its truth."""
    recording = read_recording(folder)
    document = json.loads((folder / "recording.json").read_text("utf-8"))
    data = RecordingData(document, moments=np.arange(len(recording.frames)))
    name = recording.cameras[0].name
    data.color = np.stack([read_color(frame.color[name]) for frame in recording.frames])
    files = [str(frame.depth[name]) for frame in recording.frames]
    data.depth = np.stack([cv2.imread(file, cv2.IMREAD_UNCHANGED) for file in files])
    for picker, path in recording.picker_paths.items():
        data.picker[picker] = np.column_stack([path.time_s, path.positions, path.closed])
    for key in ("template", "template_canonical"):
        document["cloth"].pop(key, None)
    if (mesh := recording.cloth.template) is not None:
        data.vertices, data.faces = mesh.vertices.astype(np.float64), mesh.faces
        data.canonical = np.asarray(mesh.canonical, np.float64)
    # Only the times of the frames stay: files have their conventional names again.
    data.times = np.array([frame.time_s for frame in recording.frames])
    with np.load(truth) as stored:
        data.truth = stored["positions"].astype(np.float64)
        data.truth_faces, data.truth_canonical = stored["faces"], stored["canonical"]
    return data
