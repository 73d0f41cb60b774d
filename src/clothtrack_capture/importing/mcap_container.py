"""MCAP files (mcap.dev/spec), read from the start; the summary at the end is not needed."""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.containers import (
    ChunkedContainer,
    Message,
    Place,
    Read,
    Record,
    Topic,
    unpack,
)

MAGIC = b"\x89MCAP0\r\n"
_KINDS = {
    Opcode.MESSAGE: "message",
    Opcode.CHUNK: "chunk",
    Opcode.SCHEMA: "definition",
    Opcode.CHANNEL: "definition",
    Opcode.DATA_END: "end",
    Opcode.FOOTER: "end",
}
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")


class McapContainer(ChunkedContainer):
    """An MCAP file of ROS 2 or ROS 1 messages."""

    def __init__(self, path: Path) -> None:
        """Open the file."""
        super().__init__(path, begin=len(MAGIC))
        self._schemas: dict[int, str] = {}
        self._ended = False

    def messages(self) -> Iterator[Message]:
        """Yield every message in file order."""
        yield from super().messages()
        if not self._ended:
            raise TruncatedError("the records end without a footer")

    def _record(self, read: Read, position: int) -> Record:
        kind, size = struct.unpack("<BQ", read(position, 9))
        self._ended = self._ended or _KINDS.get(kind) == "end"
        return Record(_KINDS.get(kind, ""), kind, position + 9, position + 9 + size)

    def _learn(self, head: int, data: bytes) -> None:
        stream = ReadDataStream(BytesIO(data))
        try:
            if head == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema.name
                return
            channel = Channel.read(stream)
        except (McapError, struct.error, ValueError) as error:
            raise TruncatedError(f"a schema or channel is damaged: {error}") from error
        name = self._schemas.get(channel.schema_id, "")
        package, _, short = name.rpartition("/")
        kind = f"{package.removesuffix('/msg')}/msg/{short}" if package else name
        self._add(channel.id, Topic(channel.topic, kind, channel.message_encoding != "ros1"))

    def _message(self, read: Read, record: Record, chunk: int) -> Iterator[Message]:
        channel, _, log_ns, _ = _MESSAGE_HEAD.unpack(read(record.start, _MESSAGE_HEAD.size))
        topic, start = self._topics.get(channel), record.start + _MESSAGE_HEAD.size
        if start > record.stop:
            raise TruncatedError("a message without its head")
        if topic is not None:
            yield Message(topic, log_ns, Place(chunk, start, record.stop - start))

    def _packed(self, record: Record) -> tuple[str, int, int]:
        compression, _, _, start, size = self._chunk_head(record)
        if start + size > record.stop:
            raise TruncatedError("a chunk's data are longer than its record")
        return compression, start, start + size

    def _unpack(self, record: Record) -> bytes:
        compression, inside, crc, start, size = self._chunk_head(record)
        chunk = unpack(self._file.read(start, size), compression, inside)
        if crc and zlib.crc32(chunk) != crc:
            raise TruncatedError("a chunk's checksum differs")
        return chunk

    def _chunk_head(self, record: Record) -> tuple[str, int, int, int, int]:
        """Return compression, unpacked size, CRC, and start and number of the packed bytes."""
        start = record.start
        _, _, inside, crc, letters = _CHUNK_HEAD.unpack(self._file.read(start, _CHUNK_HEAD.size))
        after = start + _CHUNK_HEAD.size
        compression = self._file.read(after, min(letters, 32)).decode("latin-1")
        size = struct.unpack("<Q", self._file.read(after + letters, 8))[0]
        return compression, inside, crc, after + letters + 8, size
