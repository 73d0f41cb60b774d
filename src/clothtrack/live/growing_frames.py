"""A growing sequence of frames, and the clouds of the newest from a thread of its own.

Times are in memory, pictures only while needed.
"""

import os
import tempfile
import time
import weakref
from array import array
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import overload

import numpy as np

from clothtrack.recordings.frame_files import PICTURE_KINDS
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame


@dataclass(frozen=True)
class _Stored:
    """Location of a picture in the file."""

    offset: int
    shape: tuple[int, ...]
    dtype: np.dtype


class GrowingFrames(Sequence[Frame]):
    """The frames of a live recording.

    Pictures of the newest frames are in memory. Pictures to keep go to an unnamed file and are read
    whenever their frame is accessed, so that hours of pictures need no memory.
    """

    def __init__(self) -> None:
        """Create an empty sequence."""
        self._times = array("d")
        self._shown: dict[int, Frame] = {}
        self._stored: dict[int, Mapping[str, Mapping[str, _Stored]]] = {}
        self._file = tempfile.TemporaryFile(prefix="clothtrack-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._times)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Frame, ...]: ...

    def __getitem__(self, index: int | slice) -> Frame | tuple[Frame, ...]:
        """Return one or several frames, with those pictures that were kept."""
        if isinstance(index, slice):
            return tuple(self[one] for one in range(*index.indices(len(self))))
        number = range(len(self))[index]
        shown = self._shown.get(number)
        if shown is not None:
            return shown
        stored = self._stored.get(number, {})
        pictures = {
            kind: {camera: self._read(one) for camera, one in cameras.items()}
            for kind, cameras in stored.items()
        }
        return Frame(number, self._times[number], **pictures)

    def add(self, frame: Frame) -> None:
        """Add the next frame."""
        self._times.append(frame.time_s)
        self._shown[frame.index] = frame

    def take_back(self) -> None:
        """Remove the last frame."""
        self._shown.pop(len(self) - 1, None)
        self._times.pop()

    def put_away(self, index: int, *, keep: bool) -> None:
        """Remove the pictures of a frame from memory; with `keep`, store them on disk."""
        frame = self._shown.pop(index, None)
        if frame is None or not keep:
            return
        self._stored[index] = {
            kind: {camera: self._write(np.asarray(one)) for camera, one in cameras.items()}
            for kind in PICTURE_KINDS
            if (cameras := getattr(frame, kind))
        }

    def _write(self, picture: np.ndarray) -> _Stored:
        offset = self._file.seek(0, os.SEEK_END)
        self._file.write(np.ascontiguousarray(picture).tobytes())
        return _Stored(offset, picture.shape, picture.dtype)

    def _read(self, stored: _Stored) -> np.ndarray:
        # Any thread may read, since `pread` does not use the file's shared position.
        size = int(np.prod(stored.shape)) * stored.dtype.itemsize
        data = bytearray(os.pread(self._file.fileno(), size, stored.offset))
        return np.frombuffer(data, stored.dtype).reshape(stored.shape)


class Eyes:
    """Source of the clouds; a thread observes the newest picture while the dynamics predict.

    Attributes:
        cloud: function that observes a frame; it needs the first frame.
        spent_s: CPU time of the newest cloud [s].
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="clothtrack-eyes")
        self._looks: dict[int, Future[Observation]] = {}
        self.cloud: Callable[[Frame], Observation]
        self.spent_s = 0.0

    def begin(self, frame: Frame) -> None:
        """Begin observing the newest frame."""
        self._looks = {frame.index: self._thread.submit(self._look, frame)}

    def observe(self, frame: Frame) -> Observation:
        """Return the cloud of a frame; for the newest, wait for the thread."""
        look = self._looks.pop(frame.index, None)
        return self.cloud(frame) if look is None else look.result()

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown()

    def _look(self, frame: Frame) -> Observation:
        start_s = time.thread_time()
        seen = self.cloud(frame)
        self.spent_s = time.thread_time() - start_s
        return seen
