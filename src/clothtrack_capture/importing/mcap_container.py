"""MCAP files (mcap.dev/spec), read from the start; the summary at the end is not needed."""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.containers import ChunkedContainer, Message, Read, Record, Topic

MAGIC = b"\x89MCAP0\r\n"
_MESSAGE_HEAD, _CHUNK_HEAD = struct.Struct("<HIQQ"), struct.Struct("<QQQII")


class McapContainer(ChunkedContainer):
    """An MCAP file of ROS 2 or ROS 1 messages."""

    magic = MAGIC

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
            channel, _, log_ns, _ = _MESSAGE_HEAD.unpack(read(start, _MESSAGE_HEAD.size))
            start += _MESSAGE_HEAD.size
            topic = self._topics.get(channel)
            return Record("message", start, stop - start, stop, topic, log_ns)
        if kind == Opcode.CHUNK:
            _, _, inside, crc, letters = _CHUNK_HEAD.unpack(read(start, _CHUNK_HEAD.size))
            start += _CHUNK_HEAD.size
            compression = read(start, letters).decode("latin-1")
            start += letters + 8
            size = int.from_bytes(read(start - 8, 8), "little")
            return Record("chunk", start, size, stop, None, 0, compression, inside, crc)
        if kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._learn(kind, read(start, size))
        ended = kind in (Opcode.DATA_END, Opcode.FOOTER)
        self._ended = self._ended or ended
        return Record("end" if ended else "", start, size, stop)

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
        name = self._schemas.get(channel.schema_id, "")
        package, _, short = name.rpartition("/")
        name = f"{package.removesuffix('/msg')}/msg/{short}" if package else name
        cdr = channel.message_encoding != "ros1"
        self._topics[channel.id] = Topic(channel.topic, name, cdr)
