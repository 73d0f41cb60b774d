"""Files full of messages: what ROS 1, MCAP and SQLite bags have in common.

Each is walked once from its start, record by record, and every size is checked against the file
before it is believed: a file that lies about its sizes costs no memory. Only the place of a message
is kept; its bytes are fetched when they are needed. A file that breaks off is refused.
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

# Larger than any picture and any chunk that a recorder writes; what claims more is damaged.
MOST_BYTES = 96 * 2**20
MOST_TOPICS = 10_000
_CACHED_BYTES = 2 * MOST_BYTES
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

Read = Callable[[int, int], bytes]
"""Return so many bytes from a position, all of them, or raise `TruncatedError`."""


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: such as "/camera/depth/image_raw".
        kind: message type in the ROS 2 spelling, such as "sensor_msgs/msg/Image".
        cdr: messages are serialized as in ROS 2 (CDR), else as in ROS 1.
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

    path: Path

    def topics(self) -> list[Topic]:
        """Return every topic known so far; complete when the walk has ended."""
        ...

    def messages(self) -> Iterator[Message]:
        """Yield every message, in the order of the file.

        Raises:
            TruncatedError: the file breaks off or is damaged.
        """
        ...

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`.

        Raises:
            TruncatedError: they are not there.
        """
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class BagFile:
    """A file whose bytes are read where they are needed, and a few chunks of it unpacked."""

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

    def close(self) -> None:
        """Close the file and forget what was unpacked."""
        self._chunks.clear()
        self._file.close()

    def read(self, position: int, size: int) -> bytes:
        """Return bytes of the file, all of them.

        Raises:
            TruncatedError: the file ends before, or nobody writes so many at once.
        """
        if 0 <= size <= MOST_BYTES and position + size <= self.size:
            data = os.pread(self._file.fileno(), size, position)
            if len(data) == size:
                return data
        raise TruncatedError(f"{size} bytes at {position} of {self.size}")

    def unpacked(self, position: int, unpack: Callable[[], bytes]) -> bytes:
        """Return the chunk at a position; the latest ones are kept for the next messages."""
        if position in self._chunks:
            self._chunks.move_to_end(position)
        else:
            self._chunks[position] = unpack()
            while len(self._chunks) > 1 and sum(map(len, self._chunks.values())) > _CACHED_BYTES:
                self._chunks.popitem(last=False)
        return self._chunks[position]


class Record(NamedTuple):
    """One record of a file in chunks.

    Attributes:
        kind: "message", "chunk", "definition" (of a topic), "end" (of the messages), or "".
        head: what the format says before the data.
        start: where the data begin.
        stop: where they end, and the next record begins.
    """

    kind: str
    head: Any
    start: int
    stop: int


class ChunkedContainer(ABC):
    """The walk through a file of records, some of which are chunks of further records."""

    def __init__(self, path: Path, *, begin: int) -> None:
        """Open the file, whose first record begins at this position.

        Raises:
            InvalidRecordingError: it cannot be opened.
        """
        self.path, self._begin = path, begin
        self._file = BagFile(path)
        self._topics: dict[int, Topic] = {}

    def topics(self) -> list[Topic]:
        """Return every topic known so far."""
        return list(self._topics.values())

    def messages(self) -> Iterator[Message]:
        """Yield every message, in the order of the file.

        Raises:
            TruncatedError: the file breaks off or is damaged.
        """
        yield from self._walk(self._file.read, self._begin, self._file.size, -1)

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`.

        Raises:
            TruncatedError: they are not there.
        """
        size = place.size if most is None else min(most, place.size)
        if place.chunk < 0:
            return self._file.read(place.offset, size)
        return self._unpacked(place.chunk)[place.offset : place.offset + size]

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _walk(self, read: Read, position: int, end: int, chunk: int) -> Iterator[Message]:
        """Yield the messages between two positions of the file (chunk -1) or of a chunk."""
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
        """Return the packed chunk at a position of the file."""
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
        """Return a chunk's compression, and where its packed bytes begin and end."""

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
    """Return decompressed bytes, never more than the limit.

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
