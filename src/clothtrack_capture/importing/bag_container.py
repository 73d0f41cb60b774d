"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0), read from the start."""

from rosbags.typesys.msg import normalize_msgtype

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.containers import ChunkedContainer, Read, Record, Topic

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7


class BagContainer(ChunkedContainer):
    """A ROS 1 bag; its index is not used and may be missing."""

    magic = MAGIC

    def _record(self, read: Read, position: int) -> Record:
        length = int.from_bytes(read(position, 4), "little")
        header = _fields(read(position + 4, length))
        start = position + 8 + length
        size = int.from_bytes(read(start - 4, 4), "little")
        what, span = _number(header, "op", 1), (start, size, start + size)
        if what == _MESSAGE:
            topic, time = self._topics.get(_number(header, "conn")), _number(header, "time", 8)
            log_ns = (time & 0xFFFFFFFF) * 10**9 + (time >> 32)
            return Record("message", *span, topic, log_ns)
        if what == _CHUNK:
            compression = header.get("compression", b"").decode("latin-1")
            unpacked_size = _number(header, "size")
            return Record("chunk", *span, compression=compression, unpacked_size=unpacked_size)
        if what == _CONNECTION:
            name = header.get("topic", b"").decode("utf-8", "replace")
            kind = _fields(read(start, size)).get("type", b"").decode("utf-8", "replace")
            kind = normalize_msgtype(kind) if "/" in kind else kind
            self._topics[_number(header, "conn")] = Topic(name, kind, False)
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
