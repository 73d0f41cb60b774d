"""File with the observations of one action, kept until its search is answered."""

import io
import os
import pickle
import tempfile
import weakref
from dataclasses import dataclass, replace

import numpy as np

from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame


@dataclass(frozen=True, eq=False)
class _Packed:
    """Observation whose hidden masks are packed, eight pixels per byte."""

    seen: Observation
    hidden: dict[str, tuple[tuple[int, ...], np.ndarray]]

    @classmethod
    def of(cls, seen: Observation) -> "_Packed":
        hidden = {name: (one.shape, np.packbits(one)) for name, one in seen.hidden.items()}
        return cls(replace(seen, hidden={}), hidden)

    def unpacked(self) -> Observation:
        hidden = {
            name: np.unpackbits(bits, count=int(np.prod(shape))).reshape(shape).view(bool)
            for name, (shape, bits) in self.hidden.items()
        }
        return replace(self.seen, hidden=hidden)


class SeenLog:
    """Clouds of the tracked frames of an action, without the pictures.

    Attributes:
        times_s: time of each frame [s].
        rests: whether the cloth was at rest in each frame.
    """

    def __init__(self) -> None:
        """Create an empty log; its unnamed file is deleted with this object."""
        self.frames: list[int] = []
        self.times_s: list[float] = []
        self.rests: list[bool] = []
        self._file = tempfile.TemporaryFile(prefix="clothtrack-")  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def add(self, frame: Frame, seen: Observation, *, rests: bool) -> None:
        """Add the next tracked frame."""
        self.frames.append(frame.index)
        self.times_s.append(frame.time_s)
        self.rests.append(rests)
        pickle.dump(_Packed.of(seen), self._file, pickle.HIGHEST_PROTOCOL)

    def packed(self) -> bytes:
        """Return all clouds for `unpacked`; several threads may call this."""
        self._file.flush()
        place = self._file.fileno()
        return os.pread(place, os.fstat(place).st_size, 0)


def unpacked(packed: bytes) -> list[Observation]:
    """Return the clouds of a log."""
    file, seen = io.BytesIO(packed), list[Observation]()
    while file.tell() < len(packed):
        seen.append(pickle.load(file).unpacked())
    return seen
