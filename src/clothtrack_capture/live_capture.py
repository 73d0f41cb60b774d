"""Recording from a live camera, with every frame written to disk as it arrives.

Frames and a journal go to a hidden folder `.NAME.capture` next to the target. Finishing and
salvaging do the same: the frames that the journal lists and whose files are complete become the
recording.
"""

import json
import logging
import os
import queue
import shutil
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8

from clothtrack._shown import short_repr
from clothtrack.errors import ClothTrackError, InvalidRecordingError, StorageError
from clothtrack.files.atomic_write import storage
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.frame_files import conventional_name
from clothtrack.recordings.pictures import encode_png, read_color, read_depth
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.recording_file import VERSION
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.validation import check_recording
from clothtrack.recordings.violation import DOCUMENT

logger = logging.getLogger(__name__)

_JOURNAL = "journal.jsonl"
_FLUSH_FRAMES = 15
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
            last.
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
                f"{self.folder} is left of a broken capture; finish it with --salvage, or delete it"
            )
        self._unit, self.state = source.depth_unit_m, _CaptureState()
        camera = source.camera
        head = {
            "camera": {
                **{
                    name: getattr(camera, name)
                    for name in ("name", "width", "height", "fx", "fy", "cx", "cy")
                },
                "depth_unit_m": source.depth_unit_m,
                "world_from_camera": camera.world_from_camera.tolist(),
            },
            "provenance": dict(provenance),
        }
        with storage(self.folder):
            for kind in ("depth", "color"):
                (self.folder / kind).mkdir(parents=True)
            self._journal = (self.folder / _JOURNAL).open("w", encoding="utf-8")
            self._note(head, flush=True)
        self._waiting: queue.Queue[CapturedFrame | str | None] = queue.Queue(WAITING_FRAMES)
        self._last_s: float | None = None
        self._thread = threading.Thread(target=self._write_all, daemon=True)
        self._thread.start()

    def add(self, frame: CapturedFrame) -> None:
        """Add a frame; drop and count it if the disk is too far behind."""
        if self._last_s is not None and frame.time_s <= self._last_s:
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
            StorageError: the disk refused; what was written can be salvaged.
            InvalidRecordingError: no frame was recorded.
        """
        self._waiting.put(None)
        self._thread.join()
        self._journal.close()
        if self.state.error:
            raise StorageError(f"{self.state.error}; then finish {self._target} with --salvage")
        return salvage_capture(self._target)

    def _write_all(self) -> None:
        while (frame := self._waiting.get()) is not None:
            if self.state.error:
                continue
            try:
                if isinstance(frame, str):
                    self._note({"mark": frame, "at": self.state.written}, flush=True)
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
        (self.folder / conventional_name("depth", index)).write_bytes(encode_png(depth))
        if frame.color is not None:
            (self.folder / conventional_name("color", index)).write_bytes(encode_png(frame.color))
        entry = {"index": index, "time_s": frame.time_s, "color": frame.color is not None}
        self._note(entry, flush=index % _FLUSH_FRAMES == 0)
        self.state.written += 1

    def _note(self, entry: Mapping[str, Any], *, flush: bool) -> None:
        """Append an entry to the journal; `flush` forces it to the disk."""
        self._journal.write(json.dumps(entry) + "\n")
        self._journal.flush()
        if flush:
            os.fsync(self._journal.fileno())


def capture_folder(target: Path) -> Path:
    """Return the folder that holds a recording's frames during capture."""
    return Path(target).with_name(f".{Path(target).name}.capture")


def salvage_capture(target: Path) -> Recording:
    """Make a recording of the frames that a finished or interrupted capture has written.

    Frames whose files are missing or incomplete are left out; usually these are the last ones.
    """
    target, folder = Path(target), capture_folder(target)
    if not (folder / _JOURNAL).is_file():
        raise InvalidRecordingError(f"{folder}: there is no broken capture of {target}")
    head, entries, marks = _read_journal(folder)
    unit = head["camera"]["depth_unit_m"]
    whole = [entry for entry in entries if _is_whole(folder, entry, unit)]
    if not whole:
        raise InvalidRecordingError(
            f"{folder}: none of the {len(entries)} frames is whole; delete it and record again"
        )
    if len(whole) < len(entries):
        logger.warning("%s: %d torn frames are left out", target, len(entries) - len(whole))
    start_s = whole[0]["time_s"]
    document = {
        "version": VERSION,
        "cameras": [head["camera"]],
        "frames": [
            {
                "index": place,
                "time_s": round(entry["time_s"] - start_s, 6),
                "depth": conventional_name("depth", entry["index"]),
                **({"color": conventional_name("color", entry["index"])} if entry["color"] else {}),
            }
            for place, entry in enumerate(whole)
        ],
        "provenance": {**head["provenance"], "marks": marks},
    }
    with storage(folder):
        (folder / DOCUMENT).write_text(json.dumps(document, indent=1), encoding="utf-8")
    checked = check_recording(folder)
    if checked.recording is None:
        raise InvalidRecordingError(f"{folder}: {checked.violations[0].message}")
    with storage(target):
        (folder / _JOURNAL).unlink()
        if not any((folder / "color").iterdir()):
            shutil.rmtree(folder / "color")
        folder.rename(target)
    return read_recording(target)


def _read_journal(
    folder: Path,
) -> tuple[dict[str, Any], list[dict[str, Any]], list[list[Any]]]:
    """Return head, frames and marks of a capture; incomplete lines are skipped."""
    with storage(folder / _JOURNAL):
        lines = (folder / _JOURNAL).read_bytes().split(b"\n")
    notes: list[dict[str, Any]] = []
    for line in lines:
        try:
            note = json.loads(line)
        except ValueError:
            continue
        if isinstance(note, dict):
            notes.append(note)
    if not notes or "camera" not in notes[0]:
        raise InvalidRecordingError(
            f"{folder / _JOURNAL}: its first line is gone; delete it and record again"
        )
    entries = [note for note in notes if {"index", "time_s", "color"} <= note.keys()]
    marks = [[note["mark"], note["at"]] for note in notes if {"mark", "at"} <= note.keys()]
    return notes[0], entries, marks


def _is_whole(folder: Path, entry: Mapping[str, Any], unit_m: float) -> bool:
    """Return whether a frame's pictures can be decoded and it has any depth."""
    try:
        depth = read_depth(folder / conventional_name("depth", entry["index"]), unit_m)
        if entry["color"]:
            read_color(folder / conventional_name("color", entry["index"]))
    except InvalidRecordingError:
        return False
    return bool((depth > 0).any())
