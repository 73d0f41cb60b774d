"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0), read from the start."""

import struct
from collections.abc import Iterator
from pathlib import Path

from rosbags.typesys.msg import normalize_msgtype

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

MAGIC = b"#ROSBAG V2.0\n"
_KINDS = {2: "message", 5: "chunk", 7: "definition"}
_MOST_HEADER = 2**20

Header = dict[str, bytes]
"""Fields of a record's header, by name."""


class BagContainer(ChunkedContainer):
    """A ROS 1 bag; its index is not used and may be missing."""

    def __init__(self, path: Path) -> None:
        """Open the bag."""
        super().__init__(path, begin=len(MAGIC))

    def _record(self, read: Read, position: int) -> Record:
        length = struct.unpack("<I", read(position, 4))[0]
        if length > _MOST_HEADER:
            raise TruncatedError(f"a header of {length} bytes; at most {_MOST_HEADER}")
        header = _fields(read(position + 4, length))
        start = position + 8 + length
        size = struct.unpack("<I", read(start - 4, 4))[0]
        return Record(_KINDS.get(_field(header, "op", 1)[0], ""), header, start, start + size)

    def _learn(self, head: Header, data: bytes) -> None:
        name = head.get("topic", b"").decode("utf-8", "replace")
        kind = _fields(data).get("type", b"").decode("utf-8", "replace")
        kind = normalize_msgtype(kind) if "/" in kind else kind
        self._add(_number(head, "conn"), Topic(name, kind, False))

    def _message(self, read: Read, record: Record, chunk: int) -> Iterator[Message]:  # noqa: ARG002
        topic = self._topics.get(_number(record.head, "conn"))
        seconds, nanoseconds = struct.unpack("<II", _field(record.head, "time", 8))
        if topic is not None:
            place = Place(chunk, record.start, record.stop - record.start)
            yield Message(topic, seconds * 10**9 + nanoseconds, place)

    def _packed(self, record: Record) -> tuple[str, int, int]:
        return record.head.get("compression", b"").decode("latin-1"), record.start, record.stop

    def _unpack(self, record: Record) -> bytes:
        compression, start, stop = self._packed(record)
        data = self._file.read(start, stop - start)
        return unpack(data, compression, _number(record.head, "size"))


def _fields(data: bytes) -> Header:
    fields: Header = {}
    position = 0
    while position < len(data):
        if position + 4 > len(data):
            raise TruncatedError("a header breaks off")
        size = struct.unpack_from("<I", data, position)[0]
        name, equals, value = data[position + 4 : position + 4 + size].partition(b"=")
        if not equals or position + 4 + size > len(data):
            raise TruncatedError("a header field is damaged")
        fields[name.decode("latin-1")] = value
        position += 4 + size
    return fields


def _field(header: Header, name: str, size: int) -> bytes:
    value = header.get(name, b"")
    if len(value) != size:
        raise TruncatedError(f"the header field {name} has {len(value)} bytes, not {size}")
    return value


def _number(header: Header, name: str) -> int:
    return struct.unpack("<I", _field(header, name, 4))[0]
