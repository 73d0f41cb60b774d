"""Bags as containers of messages: what ROS 1, MCAP and SQLite have in common.

A file is read once from its start, record by record. Every size is checked against the file before
it is used. Only the position of a message is kept; its bytes are fetched when they are needed.
Truncated files are refused.
"""

import bz2
import os
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import zstandard

from clothtrack.errors import TruncatedError

# Larger than any picture or chunk that a recorder writes; a larger size means a damaged file.
MOST_BYTES = 96 * 2**20
# A larger cache costs memory and saves no time: pictures are fetched nearly in file order.
_CACHED_BYTES = 24 * 2**20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

Read = Callable[[int, int], bytes]
"""A function (position, size) that returns exactly `size` bytes or raises `TruncatedError`."""


@dataclass(frozen=True)
class Topic:
    """A topic of a bag."""

    name: str  # "/camera/depth/image_raw"
    kind: str  # message type in the ROS 2 spelling: "sensor_msgs/msg/Image"
    cdr: bool  # whether messages are serialized as in ROS 2 (CDR), not as in ROS 1


class Place(NamedTuple):
    """The position of a message's bytes."""

    chunk: int  # file position of the compressed chunk; -1 if they are not in one
    offset: int  # position in the chunk or in the file, or the row of a database
    size: int
    part: int = 0  # index of the file in a bag of several


class Message(NamedTuple):
    """One message: its topic, its write time [ns] and its position."""

    topic: Topic
    log_ns: int
    place: Place


class Container(ABC):
    """A file full of messages."""

    close: Callable[[], None]

    def __init__(self, path: Path) -> None:
        self.path = path
        self._topics: dict[int, Topic] = {}

    def topics(self) -> list[Topic]:
        """Return every topic known so far; the list is complete after reading all messages."""
        return list(self._topics.values())

    @abstractmethod
    def messages(self) -> Iterator[Message]:
        """Yield every message in file order."""

    @abstractmethod
    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""


class FileOnDemand:
    """A file of which parts are read."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self.size = os.fstat(self._file.fileno()).st_size
        self.close = self._file.close

    def read(self, position: int, size: int) -> bytes:
        """Return exactly `size` bytes from a position of the file."""
        if not 0 <= size <= min(MOST_BYTES, self.size - position):
            raise TruncatedError(f"{size} bytes at {position} of {self.size}")
        return os.pread(self._file.fileno(), size, position)


class Record(NamedTuple):
    """One record of a chunked file; a definition of a topic is noted where it is read."""

    kind: str  # "message", "chunk", "end" (of the messages) or ""
    start: int  # of the message, or of the packed bytes of a chunk
    size: int
    stop: int  # where the next record begins
    topic: Topic | None = None  # of a message; None if it was never defined
    log_ns: int = 0
    compression: str = ""
    unpacked_size: int = 0
    crc: int = 0  # of the unpacked bytes; 0 if there is none


class ChunkedContainer(Container):
    """A reader for files of records, some of which are chunks of further records."""

    magic: bytes

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file = FileOnDemand(path)
        self._chunks: dict[int, bytes] = {}
        self.close = self._file.close

    def messages(self) -> Iterator[Message]:
        """Yield every message in file order."""
        yield from self._walk(self._file.read, len(self.magic), self._file.size, -1)

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""
        size = place.size if most is None else min(most, place.size)
        if place.chunk < 0:
            return self._file.read(place.offset, size)
        return self._unpacked(place.chunk)[place.offset : place.offset + size]

    @abstractmethod
    def _record(self, read: Read, position: int) -> Record:
        """Return the record at a position."""

    def _walk(self, read: Read, position: int, end: int, chunk: int) -> Iterator[Message]:
        """Yield the messages between two positions of the file (chunk -1) or a chunk."""
        while position < end:
            record = self._record(read, position)
            if record.stop > end or not 0 <= record.size <= record.stop - record.start:
                raise TruncatedError(f"a record of {record.size} bytes breaks off")
            if record.kind == "message" and record.topic is not None:
                place = Place(chunk, record.start, record.size)
                yield Message(record.topic, record.log_ns, place)
            elif record.kind == "chunk" and chunk < 0:
                if record.compression in ("", "none"):
                    yield from self._walk(read, record.start, record.start + record.size, chunk)
                else:
                    unpacked = self._unpacked(position)
                    yield from self._walk(_reader(unpacked), 0, len(unpacked), position)
            elif record.kind == "end":
                return
            position = record.stop

    def _unpacked(self, position: int) -> bytes:
        """Return the unpacked bytes of the chunk at a position; the latest chunks are cached."""
        data = self._chunks.pop(position, b"") or self._unpack(position)
        self._chunks[position] = data
        while len(self._chunks) > 1 and sum(map(len, self._chunks.values())) > _CACHED_BYTES:
            del self._chunks[next(iter(self._chunks))]
        return data

    def _unpack(self, position: int) -> bytes:
        record = self._record(self._file.read, position)
        packed = self._file.read(record.start, record.size)
        data = unpack(packed, record.compression, record.unpacked_size)
        if record.crc and zlib.crc32(data) != record.crc:
            raise TruncatedError("a chunk's checksum differs")
        return data


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
            unpacked = decoder.stream_reader(data).read(most + 1)
        elif compression == "lz4":
            unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most + 1)
        elif compression == "bz2":
            unpacked = bz2.BZ2Decompressor().decompress(data, max_length=most + 1)
        else:
            raise TruncatedError(f"compression {compression[:20]!r} is unknown")
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError) as error:
        raise TruncatedError(f"{compression}: {error}") from error
    if len(unpacked) > most or (size is not None and len(unpacked) < size):
        raise TruncatedError(f"{compression}: {len(unpacked)} bytes where {most} belong")
    return unpacked
