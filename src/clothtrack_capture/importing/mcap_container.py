"""MCAP files (mcap.dev/spec), walked from the start; the summary at the end is not needed."""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from clothtrack_capture.importing.containers import (
    MOST_BYTES,
    MOST_TOPICS,
    ChunkedContainer,
    Message,
    Place,
    Topic,
    TruncatedError,
    unpack,
)

MAGIC = b"\x89MCAP0\r\n"
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")


class McapContainer(ChunkedContainer):
    """An MCAP file of ROS 2 or ROS 1 messages."""

    def __init__(self, path: Path) -> None:
        """Open the file."""
        super().__init__(path)
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, Topic] = {}

    def topics(self) -> list[Topic]:
        """Every topic known so far."""
        return list(self._topics.values())

    def messages(self) -> Iterator[Message]:
        """Every whole message, in the order of the file; sets `damage` where the file breaks."""
        position, whole = len(MAGIC), False
        try:
            while position < self._file.size and not whole:
                kind, size = struct.unpack("<BQ", self._file.read(position, 9))
                start = position + 9
                if kind == Opcode.CHUNK:
                    yield from self._chunk(start, size)
                elif start + size > self._file.size:
                    raise TruncatedError("the last record")
                elif kind == Opcode.MESSAGE:
                    yield from self._message(self._file.read(start, min(size, 22)), start, size, -1)
                elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._learn(kind, self._file.read(start, size))
                position, whole = start + size, kind in (Opcode.DATA_END, Opcode.FOOTER)
        except TruncatedError:
            pass
        if not whole:
            self.damage = f"the file breaks off or is damaged at byte {position}"

    def _chunk_head(self, start: int) -> tuple[str, int, int, int, int]:
        """Compression, bytes inside and their CRC; where the packed bytes start and how many."""
        head = self._file.read(start, _CHUNK_HEAD.size)
        _, _, inside, crc, letters = _CHUNK_HEAD.unpack(head)
        after = start + _CHUNK_HEAD.size
        compression = self._file.read(after, min(letters, 32)).decode("latin-1")
        packed = struct.unpack("<Q", self._file.read(after + letters, 8))[0]
        return compression, inside, crc, after + letters + 8, packed

    def _chunk(self, start: int, size: int) -> Iterator[Message]:
        compression, inside, _, data, packed = self._chunk_head(start)
        if data + packed > start + size:
            raise TruncatedError("a chunk's data is longer than its record")
        if compression == "":
            # An open chunk that breaks off still gives the messages before the break.
            yield from self._inside(data, data + packed)
            return
        if inside > MOST_BYTES:
            raise TruncatedError(f"a chunk of {inside} bytes")
        chunk = self._unpacked(start)
        position = 0
        while position < len(chunk):
            if position + 9 > len(chunk):
                raise TruncatedError("a chunk breaks off")
            kind, length = struct.unpack_from("<BQ", chunk, position)
            begin = position + 9
            if begin + length > len(chunk):
                raise TruncatedError("a record is longer than its chunk")
            if kind == Opcode.MESSAGE:
                yield from self._message(chunk[begin : begin + 22], begin, length, start)
            elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(kind, chunk[begin : begin + length])
            position = begin + length

    def _inside(self, position: int, end: int) -> Iterator[Message]:
        while position < end:
            kind, length = struct.unpack("<BQ", self._file.read(position, 9))
            begin = position + 9
            if begin + length > min(end, self._file.size):
                raise TruncatedError("a record is longer than its chunk or the file")
            if kind == Opcode.MESSAGE:
                yield from self._message(self._file.read(begin, min(length, 22)), begin, length, -1)
            elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._learn(kind, self._file.read(begin, length))
            position = begin + length

    def _unpacked(self, position: int) -> bytes:
        compression, inside, crc, data, packed = self._chunk_head(position)
        chunk = unpack(self._file.read(data, packed), compression, inside)
        if crc and zlib.crc32(chunk) != crc:
            raise TruncatedError("a chunk's checksum differs")
        return self._file.keep(position, chunk)

    def _message(self, head: bytes, start: int, length: int, chunk: int) -> Iterator[Message]:
        if len(head) < _MESSAGE_HEAD.size:
            raise TruncatedError("a message without its head")
        channel, _, log_ns, _ = _MESSAGE_HEAD.unpack(head)
        topic = self._topics.get(channel)
        if topic is not None:
            place = Place(chunk, start + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size)
            yield Message(topic, log_ns, place)

    def _learn(self, kind: int, data: bytes) -> None:
        stream = ReadDataStream(BytesIO(data))
        try:
            if kind == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema.name
                return
            channel = Channel.read(stream)
        except (McapError, struct.error, ValueError) as error:
            raise TruncatedError(f"a schema or channel is damaged: {error}") from error
        if len(self._topics) >= MOST_TOPICS:
            raise TruncatedError("more topics than anybody records")
        name = self._schemas.get(channel.schema_id, "")
        package, _, short = name.rpartition("/")
        kind_name = f"{package.removesuffix('/msg')}/msg/{short}" if package else name
        self._topics[channel.id] = Topic(
            channel.topic, kind_name, channel.message_encoding != "ros1"
        )
