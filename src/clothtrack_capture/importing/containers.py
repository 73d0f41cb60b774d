"""Bags as containers of messages: ROS 1, MCAP and SQLite.

A file is read once from its start, record by record. Every size is checked against the file before
it is used. Only the position of a message is kept; its bytes are fetched when they are needed.
Truncated files are refused; indexes and summaries are not used and may be missing.
"""

import bz2
import os
import sqlite3
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from rosbags.typesys.msg import normalize_msgtype

from clothtrack.errors import InvalidRecordingError, TruncatedError

# Larger than any picture or chunk that a recorder writes; a larger size means a damaged file.
MOST_BYTES = 96 * 2**20
# A larger cache costs memory and saves no time: pictures are fetched nearly in file order.
_CACHED_BYTES = 24 * 2**20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_BAG_MESSAGE, _BAG_CHUNK, _BAG_CONNECTION = 2, 5, 7
_MCAP_MESSAGE, _MCAP_CHUNK = struct.Struct("<HIQQ"), struct.Struct("<QQQII")
_DAMAGE = (sqlite3.Error, ValueError, OverflowError, TypeError)

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

    magic: bytes  # at the start of the file
    words: str  # name of the format
    close: Callable[[], None]

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[int, Topic] = {}  # complete after reading all messages

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
                yield Message(record.topic, record.log_ns, Place(chunk, record.start, record.size))
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
        data = self._chunks.pop(position, b"")
        if not data:
            record = self._record(self._file.read, position)
            packed = self._file.read(record.start, record.size)
            data = unpack(packed, record.compression, record.unpacked_size)
            if record.crc and zlib.crc32(data) != record.crc:
                raise TruncatedError("a chunk's checksum differs")
        self._chunks[position] = data
        while len(self._chunks) > 1 and sum(map(len, self._chunks.values())) > _CACHED_BYTES:
            del self._chunks[next(iter(self._chunks))]
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


class BagContainer(ChunkedContainer):
    """A ROS 1 bag, format 2.0 (wiki.ros.org/Bags/Format/2.0)."""

    magic, words = b"#ROSBAG V2.0\n", "ROS 1 bag"

    def _record(self, read: Read, position: int) -> Record:
        length = int.from_bytes(read(position, 4), "little")
        header = _fields(read(position + 4, length))
        start = position + 8 + length
        size = int.from_bytes(read(start - 4, 4), "little")
        what, span = _number(header, "op", 1), (start, size, start + size)
        if what == _BAG_MESSAGE:
            topic, time = self.topics.get(_number(header, "conn")), _number(header, "time", 8)
            return Record("message", *span, topic, (time & 0xFFFFFFFF) * 10**9 + (time >> 32))
        if what == _BAG_CHUNK:
            compression = header.get("compression", b"").decode("latin-1")
            return Record("chunk", *span, None, 0, compression, _number(header, "size"))
        if what == _BAG_CONNECTION:
            name = header.get("topic", b"").decode("utf-8", "replace")
            kind = _fields(read(start, size)).get("type", b"").decode("utf-8", "replace")
            kind = normalize_msgtype(kind) if "/" in kind else kind
            self.topics[_number(header, "conn")] = Topic(name, kind, False)
        return Record("", *span)


def _fields(data: bytes) -> dict[str, bytes]:
    """Return the fields of a record's header, by name."""
    fields: dict[str, bytes] = {}
    position = 0
    while position < len(data):
        size = int.from_bytes(data[position : position + 4], "little")
        name, equals, value = data[position + 4 : position + 4 + size].partition(b"=")
        position += 4 + size
        if not equals or position > len(data):
            raise TruncatedError("a header field is damaged")
        fields[name.decode("latin-1")] = value
    return fields


def _number(header: dict[str, bytes], name: str, size: int = 4) -> int:
    value = header.get(name, b"")
    if len(value) != size:
        raise TruncatedError(f"the header field {name} has {len(value)} bytes, not {size}")
    return int.from_bytes(value, "little")


class McapContainer(ChunkedContainer):
    """An MCAP file (mcap.dev/spec) of ROS 2 or ROS 1 messages."""

    magic, words = b"\x89MCAP0\r\n", "MCAP"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, str] = {}
        self._ended = False

    def messages(self) -> Iterator[Message]:
        """Yield every message in file order."""
        yield from super().messages()
        if not self._ended:
            raise TruncatedError("the records end without a footer")

    def _record(self, read: Read, position: int) -> Record:
        kind, size = struct.unpack("<BQ", read(position, 9))
        start = position + 9
        stop = start + size
        if kind == Opcode.MESSAGE:
            channel, _, log_ns, _ = _MCAP_MESSAGE.unpack(read(start, _MCAP_MESSAGE.size))
            start += _MCAP_MESSAGE.size
            return Record("message", start, stop - start, stop, self.topics.get(channel), log_ns)
        if kind == Opcode.CHUNK:
            _, _, inside, crc, letters = _MCAP_CHUNK.unpack(read(start, _MCAP_CHUNK.size))
            start += _MCAP_CHUNK.size
            compression = read(start, letters).decode("latin-1")
            start += letters + 8
            size = int.from_bytes(read(start - 8, 8), "little")
            return Record("chunk", start, size, stop, None, 0, compression, inside, crc)
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._learn(kind, read(start, size))
        ended = kind in (Opcode.DATA_END, Opcode.FOOTER)
        self._ended = self._ended or ended
        return Record("end" if ended else "", start, size, stop)

    def _learn(self, what: int, data: bytes) -> None:
        stream = ReadDataStream(BytesIO(data))
        try:
            if what == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema.name
                return
            channel = Channel.read(stream)
        except (McapError, struct.error, ValueError) as error:
            raise TruncatedError(f"a schema or channel is damaged: {error}") from error
        package, _, kind = self._schemas.get(channel.schema_id, "").rpartition("/")
        kind = f"{package.removesuffix('/msg')}/msg/{kind}" if package else kind
        self.topics[channel.id] = Topic(channel.topic, kind, channel.message_encoding != "ros1")


class SqliteContainer(Container):
    """A `.db3` file of ROS 2 or the RealSense SDK, opened read-only without temporary files."""

    magic, words = b"SQLite format 3\x00", "ROS 2 bag (SQLite)"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        log = path.with_name(path.name + "-wal")
        if log.exists() and log.stat().st_size:
            raise InvalidRecordingError(
                f"{path}: the recorder was cut off, and the last messages are in {log.name}; run "
                f"sqlite3 {path.name} 'PRAGMA wal_checkpoint' on a copy of both"
            )
        uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
        self._base = sqlite3.connect(uri, uri=True, check_same_thread=False)
        self.close = self._base.close
        try:
            self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
            self._base.execute("PRAGMA trusted_schema = OFF")
            self._base.execute("PRAGMA cell_size_check = ON")
            rows = self._base.execute("SELECT id, name, type, serialization_format FROM topics")
            self.topics = {number: Topic(str(name), str(kind), form == "cdr")
                            for number, name, kind, form in rows}  # fmt: skip
            self._base.execute("SELECT topic_id, timestamp, data FROM messages LIMIT 0")
        except _DAMAGE as error:
            self.close()
            cause = " ".join(str(error).split())  # It may quote a table's definition.
            raise InvalidRecordingError(
                f"{path}: the data base cannot be read ({cause}); record or copy it again"
            ) from error

    def messages(self) -> Iterator[Message]:
        """Yield every message in write order."""
        last = -(2**63)
        try:
            rows = self._base.execute(
                "SELECT rowid, topic_id, timestamp, length(data) FROM messages ORDER BY rowid"
            )
            for row, topic, time, size in rows:
                if not (isinstance(row, int) and row > last):
                    raise TruncatedError(f"the rows after {last} run in circles")
                last = row
                if topic in self.topics and isinstance(time, int) and isinstance(size, int):
                    yield Message(self.topics[topic], time, Place(-1, row, size))
        except _DAMAGE as error:
            raise TruncatedError(f"after row {last}: {error}") from error

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""
        try:
            with self._base.blobopen("messages", "data", place.offset, readonly=True) as blob:
                return blob.read(MOST_BYTES if most is None else most)
        except _DAMAGE as error:
            raise TruncatedError(f"row {place.offset}: {error}") from error


def _kind_of(path: Path) -> type[Container] | None:
    with path.open("rb") as file:
        start = file.read(16)
    kinds = (BagContainer, McapContainer, SqliteContainer)
    return next((kind for kind in kinds if start.startswith(kind.magic)), None)


def is_bag(path: Path) -> bool:
    """Return whether a file starts like one of the supported bags."""
    return _kind_of(path) is not None


def open_part(path: Path) -> Container:
    """Return the reader of one file of a bag."""
    if (kind := _kind_of(path)) is not None:
        return kind(path)
    raise InvalidRecordingError(
        f"{path}: neither a ROS 1 bag, nor MCAP, nor SQLite; record or copy it again"
    )
