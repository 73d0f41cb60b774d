"""Recording from a live camera, with every frame written to disk as it arrives.

Frames go to a hidden folder `.NAME.capture` next to the target, which finishing renames. The folder
is a recording of all but its last frames at any time, so that whoever is left with one renames it.
"""

import json
import math
import queue
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from clothtrack._shown import short_repr
from clothtrack.errors import ClothTrackError, InvalidRecordingError, StorageError
from clothtrack.files.atomic_write import remove_folder, storage, write_file
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.frame_files import conventional_name
from clothtrack.recordings.pictures import encode_png, read_color, read_depth
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.recording_file import VERSION
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.violation import DOCUMENT

_LISTED_EVERY = 30
"""Number of frames after which the document lists them all."""

WAITING_FRAMES = 60


@dataclass(frozen=True, eq=False)
class CapturedFrame:
    """One frame from a live camera.

    Attributes:
        time_s: time on the camera's clock [s].
        color: color picture, red first, registered to depth; None without a color camera.
        depth_m: depth [m], 0 where nothing was measured.
    """

    time_s: float
    color: UInt8[np.ndarray, "height width 3"] | None
    depth_m: Float[np.ndarray, "height width"]

    __repr__ = short_repr


@runtime_checkable
class DepthCamera(Protocol):
    """A live camera: a real one, a simulated one, or a replayed recording."""

    camera: Camera
    depth_unit_m: float

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield frames as they arrive, until there are no more."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...


class ReplayedCamera:
    """A recording replayed as if it were a camera."""

    def __init__(self, recording: Recording, *, speed: float = 1.0) -> None:
        """Play the first camera of a recording.

        Args:
            recording: recording with depth.
            speed: factor on the recording's speed; infinite to replay without waiting.

        Raises:
            InvalidRecordingError: the camera has no depth.
        """
        self.camera = recording.cameras[0]
        self.depth_unit_m = recording.depth_units_m.get(self.camera.name, 0.001)
        self._speed = speed
        self._frames = [frame for frame in recording.frames if self.camera.name in frame.depth]
        if not self._frames:
            raise InvalidRecordingError(
                f"{recording.folder}: camera {self.camera.name!r} has no depth to play"
            )

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield frames at the times of the recording, scaled by the speed."""
        start, name = time.monotonic(), self.camera.name
        for frame in self._frames:
            wait = (frame.time_s - self._frames[0].time_s) / self._speed
            time.sleep(max(0.0, start + wait - time.monotonic()))
            color = read_color(frame.color[name]) if name in frame.color else None
            yield CapturedFrame(
                frame.time_s, color, read_depth(frame.depth[name], self.depth_unit_m)
            )

    def close(self) -> None:
        """Do nothing; there is no device to release."""


@dataclass
class _CaptureState:
    """The state of a capture.

    Attributes:
        dropped: number of frames that came faster than the disk could take them, or not after the
            last, or without any depth.
        error: reason why writing stopped; empty while there is none.
    """

    written: int = 0
    dropped: int = 0
    error: str = ""


class CaptureWriter:
    """A writer of frames with its own thread, so that the camera never waits."""

    def __init__(self, target: Path, source: DepthCamera, provenance: Mapping[str, Any]) -> None:
        """Create the hidden folder.

        Raises:
            StorageError: the target or an unfinished capture of it exists, or the disk refuses.
        """
        self._target, self.folder = Path(target), capture_folder(target)
        if self._target.exists():
            raise StorageError(f"{target} exists; delete it or record to another name")
        if self.folder.exists():
            raise StorageError(
                f"{self.folder} is left of a broken capture; rename it to keep its frames, or "
                "delete it"
            )
        self._unit, self.state = source.depth_unit_m, _CaptureState()
        camera = source.camera
        names = ("name", "width", "height", "fx", "fy", "cx", "cy")
        self._document: dict[str, Any] = {
            "version": VERSION,
            "cameras": [
                {name: getattr(camera, name) for name in names}
                | {
                    "depth_unit_m": source.depth_unit_m,
                    "world_from_camera": camera.world_from_camera.tolist(),
                }
            ],
            "frames": [],
            "provenance": {**provenance, "marks": []},
        }
        with storage(self.folder):
            (self.folder / "depth").mkdir(parents=True)
        self._waiting: queue.Queue[CapturedFrame | str | None] = queue.Queue(WAITING_FRAMES)
        self._start_s = self._last_s = -math.inf
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    def add(self, frame: CapturedFrame) -> None:
        """Add a frame; drop and count it if the disk is too far behind."""
        if frame.time_s <= self._last_s:
            self.state.dropped += 1
            return
        try:
            self._waiting.put_nowait(frame)
        except queue.Full:
            self.state.dropped += 1
        else:
            self._last_s = frame.time_s

    def mark(self, step: str) -> None:
        """Record that a step of the protocol begins with the next frame."""
        self._waiting.put(step)

    def finish(self) -> Recording:
        """Write the waiting frames, and make a recording of all frames.

        Raises:
            StorageError: the disk refused; the frames before that stay in `folder`.
            InvalidRecordingError: no frame was recorded, or a picture has another size.
        """
        self._waiting.put(None)
        self._thread.join()
        if self.state.error:
            with suppress(StorageError):
                self._list_frames()
            raise StorageError(
                f"{self.state.error}; then rename {self.folder} to keep the {self.state.written} "
                "frames before"
            )
        if not self.state.written:
            remove_folder(self.folder)
            raise InvalidRecordingError(f"{self._target}: no frame with depth was recorded")
        self._list_frames()
        read_recording(self.folder)
        with storage(self._target):
            self.folder.rename(self._target)
        return read_recording(self._target)

    def _write_all(self) -> None:
        while (frame := self._waiting.get()) is not None:
            if self.state.error:
                continue
            try:
                if isinstance(frame, str):
                    self._document["provenance"]["marks"].append([frame, self.state.written])
                else:
                    self._write(frame)
            except OSError as error:
                self.state.error = str(StorageError.of(error))
            except ClothTrackError as error:
                self.state.error = str(error)

    def _write(self, frame: CapturedFrame) -> None:
        index = self.state.written
        units = np.rint(np.nan_to_num(frame.depth_m, nan=0.0, posinf=0.0) / self._unit)
        depth = np.where((units > 0) & (units <= 65535), units, 0).astype(np.uint16)
        if not depth.any():
            self.state.dropped += 1
            return
        if index == 0:
            self._start_s = frame.time_s
        entry = {"index": index, "time_s": round(frame.time_s - self._start_s, 6)}
        for kind, picture in (("depth", depth), ("color", frame.color)):
            if picture is not None:
                entry[kind] = conventional_name(kind, index)
                file = self.folder / entry[kind]
                file.parent.mkdir(exist_ok=True)
                file.write_bytes(encode_png(picture))
        self._document["frames"].append(entry)
        self.state.written += 1
        if index % _LISTED_EVERY == 0:
            self._list_frames()

    def _list_frames(self) -> None:
        text = json.dumps(self._document, indent=1)
        write_file(self.folder / DOCUMENT, text.encode())


def capture_folder(target: Path) -> Path:
    """Return the folder that holds a recording's frames during capture."""
    return Path(target).with_name(f".{Path(target).name}.capture")
