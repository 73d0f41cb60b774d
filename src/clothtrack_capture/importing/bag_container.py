"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0), walked from the start."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from rosbags.typesys.msg import normalize_msgtype

from clothtrack_capture.importing.containers import (
    MOST_TOPICS,
    ChunkedContainer,
    Message,
    Place,
    Topic,
    TruncatedError,
    unpack,
)

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_MOST_HEADER = 2**20


class BagContainer(ChunkedContainer):
    """A ROS 1 bag; its index is not read, so it need not have one."""

    def __init__(self, path: Path) -> None:
        """Open the bag."""
        super().__init__(path)
        self._topics: dict[int, Topic] = {}

    def topics(self) -> list[Topic]:
        """Every topic known so far."""
        return list(self._topics.values())

    def messages(self) -> Iterator[Message]:
        """Every whole message, in the order of the file; sets `damage` where the file breaks."""
        position = len(MAGIC)
        try:
            while position < self._file.size:
                header, start, stop = self._record(self._file.read, position)
                kind = _byte(header, "op")
                if kind == _CONNECTION:
                    self._learn(header, self._file.read(start, stop - start))
                elif kind == _CHUNK:
                    yield from self._chunk(position, header, start, stop)
                elif kind == _MESSAGE:
                    if stop > self._file.size:
                        raise TruncatedError("the last message")
                    yield from self._message(header, Place(-1, start, stop - start))
                if stop > self._file.size:
                    raise TruncatedError("the last record")
                position = stop
        except TruncatedError:
            self.damage = f"the bag breaks off or is damaged at byte {position}"

    def _chunk(
        self, position: int, header: dict[str, bytes], start: int, stop: int
    ) -> Iterator[Message]:
        if header.get("compression", b"none") == b"none":
            # An open chunk that breaks off still gives the messages before the break.
            yield from self._inside(self._file.read, start, min(stop, self._file.size), -1)
        else:
            chunk = self._unpacked(position)
            yield from self._inside(_reader(chunk), 0, len(chunk), position)

    def _unpacked(self, position: int) -> bytes:
        header, start, stop = self._record(self._file.read, position)
        compression = header.get("compression", b"").decode("latin-1")
        size = struct.unpack("<I", _field(header, "size", 4))[0]
        return self._file.keep(
            position, unpack(self._file.read(start, stop - start), compression, size)
        )

    def _inside(
        self, read: Callable[[int, int], bytes], position: int, end: int, chunk: int
    ) -> Iterator[Message]:
        while position < end:
            header, start, stop = self._record(read, position)
            if stop > end:
                raise TruncatedError("a record is longer than its chunk")
            kind = _byte(header, "op")
            if kind == _CONNECTION:
                self._learn(header, read(start, stop - start))
            elif kind == _MESSAGE:
                yield from self._message(header, Place(chunk, start, stop - start))
            position = stop

    def _message(self, header: dict[str, bytes], place: Place) -> Iterator[Message]:
        topic = self._topics.get(struct.unpack("<I", _field(header, "conn", 4))[0])
        seconds, nanoseconds = struct.unpack("<II", _field(header, "time", 8))
        if topic is not None:
            yield Message(topic, seconds * 10**9 + nanoseconds, place)

    def _learn(self, header: dict[str, bytes], data: bytes) -> None:
        number = struct.unpack("<I", _field(header, "conn", 4))[0]
        about = _fields(data)
        name = header.get("topic", b"").decode("utf-8", "replace")
        kind = about.get("type", b"").decode("utf-8", "replace")
        if len(self._topics) >= MOST_TOPICS:
            raise TruncatedError("more topics than anybody records")
        self._topics[number] = Topic(name, normalize_msgtype(kind) if "/" in kind else kind, False)

    def _record(
        self, read: Callable[[int, int], bytes], position: int
    ) -> tuple[dict[str, bytes], int, int]:
        length = struct.unpack("<I", read(position, 4))[0]
        if length > _MOST_HEADER:
            raise TruncatedError(f"a header of {length} bytes")
        header = _fields(read(position + 4, length))
        start = position + 8 + length
        size = struct.unpack("<I", read(start - 4, 4))[0]
        return header, start, start + size


def _reader(data: bytes) -> Callable[[int, int], bytes]:
    def read(position: int, size: int) -> bytes:
        if position + size > len(data):
            raise TruncatedError("a chunk breaks off")
        return data[position : position + size]

    return read


def _fields(data: bytes) -> dict[str, bytes]:
    fields: dict[str, bytes] = {}
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


def _field(header: dict[str, bytes], name: str, size: int) -> bytes:
    value = header.get(name, b"")
    if len(value) != size:
        raise TruncatedError(f"the header field {name} has {len(value)} bytes, not {size}")
    return value


def _byte(header: dict[str, bytes], name: str) -> int:
    return _field(header, name, 1)[0]
