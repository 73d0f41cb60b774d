"""Files full of messages: what ROS 1, MCAP and SQLite bags have in common.

Each is walked once from its start, record by record, every size held against the file before it is
believed. So a file that breaks off gives what is whole before the break, a file that lies about its
sizes costs no memory, and only the place of a message is kept: its bytes are fetched when wanted.
"""

import bz2
import os
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, runtime_checkable

import lz4.frame
import zstandard

from clothtrack.errors import InvalidRecordingError, TruncatedError

# Larger than any picture and any chunk that a recorder writes; what claims more is damaged.
MOST_BYTES = 96 * 2**20
MOST_TOPICS = 10_000
_CACHED_BYTES = 2 * MOST_BYTES
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: such as "/camera/depth/image_raw".
        kind: message type in the ROS 2 spelling, such as "sensor_msgs/msg/Image".
        cdr: messages are serialised as in ROS 2 (CDR), else as in ROS 1.
    """

    name: str
    kind: str
    cdr: bool


class Place(NamedTuple):
    """Where a message's bytes lie.

    Attributes:
        chunk: file position of the compressed chunk, or -1 when they lie open in the file.
        offset: position in the chunk, in the file, or the row of a data base.
        size: how many bytes.
        part: which file of a bag in several parts.
    """

    chunk: int
    offset: int
    size: int
    part: int = 0


class Message(NamedTuple):
    """One message: of which topic, when it was written [ns] and where it lies."""

    topic: Topic
    log_ns: int
    place: Place


@runtime_checkable
class Container(Protocol):
    """A file full of messages."""

    damage: str | None

    def topics(self) -> list[Topic]:
        """Every topic known so far; complete when the walk has ended."""
        ...

    def messages(self) -> Iterator[Message]:
        """Every whole message, in the order of the file; sets `damage` where the file breaks."""
        ...

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """The bytes of a message, or only the first `most`.

        Raises:
            TruncatedError: they are not there.
        """
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


class BagFile:
    """A file whose bytes are read where they are wanted, and a few chunks of it unpacked."""

    def __init__(self, path: Path) -> None:
        """Open the file for reading.

        Raises:
            InvalidRecordingError: it cannot be opened.
        """
        self.path = path
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InvalidRecordingError(f"{path}: {error.strerror}; check the name") from error
        self.size = os.fstat(self._file.fileno()).st_size
        self._chunks: OrderedDict[int, bytes] = OrderedDict()

    def __enter__(self) -> "BagFile":
        """The file itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file and forget what was unpacked."""
        self._chunks.clear()
        self._file.close()

    def read(self, position: int, size: int) -> bytes:
        """Bytes of the file, all of them.

        Raises:
            TruncatedError: the file ends before, or nobody writes so many at once.
        """
        if not 0 <= size <= MOST_BYTES or position + size > self.size:
            raise TruncatedError(f"{size} bytes at {position} of {self.size}")
        data = os.pread(self._file.fileno(), size, position)
        if len(data) < size:
            raise TruncatedError(f"{size} bytes at {position} of {self.size}")
        return data

    def keep(self, position: int, unpacked: bytes) -> bytes:
        """Remember an unpacked chunk for the next messages; old ones are forgotten."""
        self._chunks[position] = unpacked
        while len(self._chunks) > 1 and sum(map(len, self._chunks.values())) > _CACHED_BYTES:
            self._chunks.popitem(last=False)
        return unpacked

    def kept(self, position: int) -> bytes | None:
        """An unpacked chunk that is still remembered."""
        if position in self._chunks:
            self._chunks.move_to_end(position)
        return self._chunks.get(position)


class ChunkedContainer(ABC):
    """What containers with compressed chunks have in common: how a message is fetched."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            InvalidRecordingError: it cannot be opened.
        """
        self.damage: str | None = None
        self._file = BagFile(path)

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """The bytes of a message, or only the first `most`.

        Raises:
            TruncatedError: they are not there.
        """
        size = place.size if most is None else min(most, place.size)
        if place.chunk < 0:
            return self._file.read(place.offset, size)
        chunk = self._file.kept(place.chunk)
        if chunk is None:
            chunk = self._unpacked(place.chunk)
        return chunk[place.offset : place.offset + size]

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    @abstractmethod
    def _unpacked(self, position: int) -> bytes:
        """The chunk at a position of the file, unpacked and remembered.

        Raises:
            TruncatedError: it is not there, or damaged.
        """


def unpack(data: bytes, compression: str, size: int | None = None) -> bytes:
    """Decompressed bytes, never more than the limit.

    Args:
        data: what was compressed.
        compression: "zstd", "lz4", "bz2" or nothing.
        size: how many bytes it must give, when known.

    Raises:
        TruncatedError: damaged, larger than the limit or of an unknown kind.
    """
    most = MOST_BYTES if size is None else size
    if most > MOST_BYTES:
        raise TruncatedError(f"a chunk of {most} bytes; at most {MOST_BYTES}")
    try:
        if compression == "zstd":
            decoder = zstandard.ZstdDecompressor(max_window_size=2**27)
            with decoder.stream_reader(data) as stream:
                unpacked = stream.read(most + 1)
        elif compression == "lz4":
            unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most + 1)
        elif compression == "bz2":
            unpacked = bz2.BZ2Decompressor().decompress(data, max_length=most + 1)
        elif compression in ("", "none"):
            unpacked = data
        else:
            raise TruncatedError(f"compression {compression[:20]!r} is unknown")
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError) as error:
        raise TruncatedError(f"{compression}: {error}") from error
    if len(unpacked) > most or (size is not None and len(unpacked) < size):
        raise TruncatedError(f"{compression}: {len(unpacked)} bytes where {most} belong")
    return unpacked
