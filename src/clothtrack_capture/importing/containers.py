"""Message containers: the common parts of ROS 1, MCAP and SQLite bags.

Each file is read once from its start, record by record. Every size is checked against the file
before it is used, so that a wrong size costs no memory. Only the position of a message is kept; its
bytes are fetched when they are needed. Truncated files are refused.
"""

import bz2
import os
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import lz4.frame
import zstandard

from clothtrack.errors import InvalidRecordingError, TruncatedError

# Larger than any picture or chunk that a recorder writes; a larger size means a damaged file.
MOST_BYTES = 96 * 2**20
MOST_TOPICS = 10_000
# A larger cache costs memory and saves no time: pictures are fetched nearly in file order.
_CACHED_BYTES = 24 * 2**20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

Read = Callable[[int, int], bytes]
"""A function (position, size) that returns exactly `size` bytes or raises `TruncatedError`."""


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: topic name, such as "/camera/depth/image_raw".
        kind: message type in the ROS 2 spelling, such as "sensor_msgs/msg/Image".
        cdr: whether messages are serialized as in ROS 2 (CDR); otherwise as in ROS 1.
    """

    name: str
    kind: str
    cdr: bool


class Place(NamedTuple):
    """The position of a message's bytes.

    Attributes:
        chunk: file position of the compressed chunk, or -1 if the bytes are not in a chunk.
        offset: position in the chunk or in the file, or the row of a database.
        size: number of bytes.
        part: index of the file in a bag of several parts.
    """

    chunk: int
    offset: int
    size: int
    part: int = 0


class Message(NamedTuple):
    """One message: its topic, its write time [ns] and its position."""

    topic: Topic
    log_ns: int
    place: Place


@runtime_checkable
class Container(Protocol):
    """A file full of messages."""

    path: Path

    def topics(self) -> list[Topic]:
        """Return every topic known so far; the list is complete after reading all messages."""
        ...

    def messages(self) -> Iterator[Message]:
        """Yield every message in file order."""
        ...

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class BagFile:
    """A file read on demand, with a cache of a few unpacked chunks."""

    def __init__(self, path: Path) -> None:
        """Open the file for reading."""
        self.path = path
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InvalidRecordingError(f"{path}: {error.strerror}; check the name") from error
        self.size = os.fstat(self._file.fileno()).st_size
        self._chunks: OrderedDict[int, bytes] = OrderedDict()

    def close(self) -> None:
        """Close the file and clear the cache."""
        self._chunks.clear()
        self._file.close()

    def read(self, position: int, size: int) -> bytes:
        """Return exactly `size` bytes from a position of the file."""
        if 0 <= size <= MOST_BYTES and position + size <= self.size:
            data = os.pread(self._file.fileno(), size, position)
            if len(data) == size:
                return data
        raise TruncatedError(f"{size} bytes at {position} of {self.size}")

    def unpacked(self, position: int, unpack: Callable[[], bytes]) -> bytes:
        """Return the unpacked chunk at a position; the latest chunks are cached."""
        if position in self._chunks:
            self._chunks.move_to_end(position)
        else:
            self._chunks[position] = unpack()
            while len(self._chunks) > 1 and sum(map(len, self._chunks.values())) > _CACHED_BYTES:
                self._chunks.popitem(last=False)
        return self._chunks[position]


class Record(NamedTuple):
    """One record of a chunked file.

    Attributes:
        kind: "message", "chunk", "definition" (of a topic), "end" (of the messages), or "".
        head: header of the record.
        start: position at which the data begin.
        stop: position at which the data end and the next record begins.
    """

    kind: str
    head: Any
    start: int
    stop: int


class ChunkedContainer(ABC):
    """A reader for files of records, some of which are chunks of further records."""

    def __init__(self, path: Path, *, begin: int) -> None:
        """Open the file, whose first record begins at `begin`."""
        self.path, self._begin = path, begin
        self._file = BagFile(path)
        self._topics: dict[int, Topic] = {}

    def topics(self) -> list[Topic]:
        """Return every topic known so far."""
        return list(self._topics.values())

    def messages(self) -> Iterator[Message]:
        """Yield every message in file order."""
        yield from self._walk(self._file.read, self._begin, self._file.size, -1)

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""
        size = place.size if most is None else min(most, place.size)
        if place.chunk < 0:
            return self._file.read(place.offset, size)
        return self._unpacked(place.chunk)[place.offset : place.offset + size]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _walk(self, read: Read, position: int, end: int, chunk: int) -> Iterator[Message]:
        """Yield the messages between two positions of the file (chunk -1) or a chunk."""
        while position < end:
            record = self._record(read, position)
            if record.stop > end:
                raise TruncatedError(f"a record of {record.stop - record.start} bytes breaks off")
            if record.kind == "message":
                yield from self._message(read, record, chunk)
            elif record.kind == "definition":
                self._learn(record.head, read(record.start, record.stop - record.start))
            elif record.kind == "chunk" and chunk < 0:
                compression, data, stop = self._packed(record)
                if compression in ("", "none"):
                    yield from self._walk(read, data, stop, chunk)
                else:
                    unpacked = self._unpacked(position)
                    yield from self._walk(_reader(unpacked), 0, len(unpacked), position)
            position = record.stop
            if record.kind == "end":
                return

    def _add(self, number: int, topic: Topic) -> None:
        if len(self._topics) >= MOST_TOPICS:
            raise TruncatedError(f"more than {MOST_TOPICS} topics")
        self._topics[number] = topic

    def _unpacked(self, position: int) -> bytes:
        """Return the unpacked bytes of the chunk at a position of the file."""
        return self._file.unpacked(
            position, lambda: self._unpack(self._record(self._file.read, position))
        )

    @abstractmethod
    def _record(self, read: Read, position: int) -> Record:
        """Return the record at a position."""

    @abstractmethod
    def _learn(self, head: Any, data: bytes) -> None:
        """Add the topic that a definition describes."""

    @abstractmethod
    def _message(self, read: Read, record: Record, chunk: int) -> Iterator[Message]:
        """Yield the message of a record, unless its topic was never defined."""

    @abstractmethod
    def _packed(self, record: Record) -> tuple[str, int, int]:
        """Return a chunk's compression, and the start and end of its packed bytes."""

    @abstractmethod
    def _unpack(self, record: Record) -> bytes:
        """Return the unpacked bytes of a chunk."""


def _reader(data: bytes) -> Read:
    def read(position: int, size: int) -> bytes:
        if position + size > len(data):
            raise TruncatedError("a chunk breaks off")
        return data[position : position + size]

    return read


def unpack(data: bytes, compression: str, size: int | None = None) -> bytes:
    """Return the decompressed bytes, at most as many as the limit."""
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
