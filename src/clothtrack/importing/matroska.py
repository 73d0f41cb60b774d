"""Matroska files (RFC 9559): tracks, attachments, tags, and the place of every block.

Only what the recorders of depth cameras write is read; sizes are held against the file before they
are believed, and a file that breaks off gives its whole blocks.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from clothtrack.importing.containers import BagFile, TruncatedError

MAGIC = b"\x1a\x45\xdf\xa3"
_UNKNOWN = -1
_MOST_TEXT = 64 * 1024
_MOST_ATTACHMENT = 16 * 2**20
_MOST_ENTRIES = 1000
_SEGMENT, _INFO, _TRACKS, _CLUSTER = 0x18538067, 0x1549A966, 0x1654AE6B, 0x1F43B675
_ATTACHMENTS, _TAGS = 0x1941A469, 0x1254C367
_GROUP, _BLOCK, _SIMPLE_BLOCK, _CLUSTER_TIME = 0xA0, 0xA1, 0xA3, 0xE7
_TICK_NS, _TRACK, _ATTACHED, _TAG = 0x2AD7B1, 0xAE, 0x61A7, 0x7373
_TRACK_NUMBERS = {0xD7: "number", 0x73C5: "uid", 0xB0: "width", 0xBA: "height"}
_TRACK_TEXTS = {0x536E: "name", 0x86: "codec"}
_PRIVATE, _VIDEO = 0x63A2, 0xE0
_TARGETS, _SIMPLE_TAG, _TARGET_TRACK, _TAG_NAME, _TAG_TEXT = 0x63C0, 0x67C8, 0x63C5, 0x45A3, 0x4487


@dataclass
class Track:
    """A track of pictures.

    Attributes:
        number: by which blocks name it.
        uid: by which tags name it.
        name: such as "DEPTH".
        codec: such as "V_MJPEG" or "V_MS/VFW/FOURCC".
        private: the codec's own data.
        width: picture width [pixels].
        height: picture height [pixels].
    """

    number: int = 0
    uid: int = 0
    name: str = ""
    codec: str = ""
    private: bytes = b""
    width: int = 0
    height: int = 0


@dataclass(frozen=True, slots=True)
class Block:
    """One picture: track number, time [ns], and where its bytes lie."""

    track: int
    time_ns: int
    offset: int
    size: int


@dataclass
class Matroska:
    """What a file holds besides its blocks.

    Attributes:
        tracks: every track.
        tags: value per tag name.
        track_tags: per name of a tag of one track, that track's uid.
        attachments: content per file name.
        tick_ns: nanoseconds per unit of time.
    """

    tracks: list[Track] = field(default_factory=list)
    tags: dict[str, str] = field(default_factory=dict)
    track_tags: dict[str, int] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    tick_ns: int = 1_000_000


class MatroskaReader:
    """Walks through a Matroska file once and fetches blocks afterwards."""

    def __init__(self, path: Path) -> None:
        """Open the file."""
        self.damage: str | None = None
        self.content = Matroska()
        self._file = BagFile(path)
        self._cluster_time = 0

    def fetch(self, block: Block) -> bytes:
        """The bytes of a block.

        Raises:
            TruncatedError: they are not there.
        """
        return self._file.read(block.offset, block.size)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def blocks(self) -> Iterator[Block]:
        """Every whole block, in the order of the file; fills `content`, sets `damage`."""
        position = 0
        try:
            while position < self._file.size:
                kind, start, stop = self._element(position)
                if kind in (_SEGMENT, _CLUSTER):
                    # Its own elements follow; a recorder that was cut off never wrote its size.
                    self._cluster_time, position = 0, start
                    continue
                if kind == _CLUSTER_TIME:
                    self._cluster_time = self._number(start, stop)
                elif kind == _SIMPLE_BLOCK:
                    yield self._block(start, stop)
                elif kind == _GROUP:
                    for inner, begin, end in self._elements(start, stop):
                        if inner == _BLOCK:
                            yield self._block(begin, end)
                else:
                    self._learn(kind, start, stop)
                position = stop
        except TruncatedError:
            self.damage = f"the file breaks off or is damaged at byte {position}"

    def _learn(self, kind: int, start: int, stop: int) -> None:
        content = self.content
        if kind not in (_INFO, _TRACKS, _ATTACHMENTS, _TAGS):
            return
        for inner, begin, end in self._elements(start, stop):
            if inner == _TICK_NS:
                content.tick_ns = max(self._number(begin, end), 1)
            elif inner == _TRACK and len(content.tracks) < _MOST_ENTRIES:
                content.tracks.append(self._track(begin, end))
            elif inner == _ATTACHED and len(content.attachments) < _MOST_ENTRIES:
                self._attachment(begin, end)
            elif inner == _TAG and len(content.tags) < _MOST_ENTRIES:
                self._tag(begin, end)

    def _track(self, start: int, stop: int) -> Track:
        track = Track()
        for kind, begin, end in self._elements(start, stop):
            if kind in _TRACK_NUMBERS:
                setattr(track, _TRACK_NUMBERS[kind], self._number(begin, end))
            elif kind in _TRACK_TEXTS:
                setattr(track, _TRACK_TEXTS[kind], self._text(begin, end))
            elif kind == _PRIVATE:
                track.private = self._file.read(begin, min(end - begin, _MOST_TEXT))
            elif kind == _VIDEO:
                for inner, first, last in self._elements(begin, end):
                    if inner in _TRACK_NUMBERS:
                        setattr(track, _TRACK_NUMBERS[inner], self._number(first, last))
        return track

    def _attachment(self, start: int, stop: int) -> None:
        name, data = "", b""
        for kind, begin, end in self._elements(start, stop):
            if kind == 0x466E:
                name = self._text(begin, end)
            elif kind == 0x465C:
                if end - begin > _MOST_ATTACHMENT:
                    raise TruncatedError(f"an attachment of {end - begin} bytes")
                data = self._file.read(begin, end - begin)
        self.content.attachments[name] = data

    def _tag(self, start: int, stop: int) -> None:
        target = 0
        pairs: list[dict[int, str]] = []
        for kind, begin, end in self._elements(start, stop):
            inside = self._elements(begin, end) if kind in (_TARGETS, _SIMPLE_TAG) else ()
            if kind == _SIMPLE_TAG:
                pairs.append({one: self._text(*span) for one, *span in inside})
            for inner, first, last in inside:
                if inner == _TARGET_TRACK:
                    target = self._number(first, last)
        for pair in pairs[:_MOST_ENTRIES]:
            name = pair.get(_TAG_NAME, "")
            self.content.tags[name] = pair.get(_TAG_TEXT, "")
            if target:
                self.content.track_tags[name] = target

    def _block(self, start: int, stop: int) -> Block:
        head = self._file.read(start, min(stop - start, 12))
        track, width = _vint(head, marked=False)
        if len(head) < width + 3:
            raise TruncatedError("a block breaks off")
        ticks, flags = struct.unpack_from(">hB", head, width)
        if flags & 0x06:
            raise TruncatedError("laced blocks are for sound, not for pictures")
        time = (self._cluster_time + ticks) * self.content.tick_ns
        if not abs(time) < 2**62:
            raise TruncatedError("a time beyond all times")
        return Block(track, time, start + width + 3, stop - start - width - 3)

    def _elements(self, start: int, stop: int) -> Iterator[tuple[int, int, int]]:
        position = start
        while position < stop:
            kind, begin, end = self._element(position)
            if end > stop:
                raise TruncatedError("an element is longer than the one around it")
            yield kind, begin, end
            position = end

    def _element(self, position: int) -> tuple[int, int, int]:
        head = self._file.read(position, min(12, self._file.size - position))
        kind, width = _vint(head, marked=True)
        size, more = _vint(head[width:], marked=False)
        start = position + width + more
        if kind in (_SEGMENT, _CLUSTER):
            return kind, start, start
        if size == _UNKNOWN or start + size > self._file.size:
            raise TruncatedError("an element without a size, or longer than the file")
        return kind, start, start + size

    def _number(self, start: int, stop: int) -> int:
        if stop - start > 8:
            raise TruncatedError("a number of more than eight bytes")
        return int.from_bytes(self._file.read(start, stop - start), "big")

    def _text(self, start: int, stop: int) -> str:
        data = self._file.read(start, min(stop - start, _MOST_TEXT))
        return data.split(b"\0")[0].decode("utf-8", "replace")


def _vint(data: bytes, *, marked: bool) -> tuple[int, int]:
    """A number of variable length and its width; the mark of the width stays in identifiers."""
    if not data or not data[0]:
        raise TruncatedError("a number of unknown length")
    width = 9 - data[0].bit_length()
    if len(data) < width:
        raise TruncatedError("a number breaks off")
    value = int.from_bytes(data[:width], "big")
    if marked:
        return value, width
    bits = (1 << (7 * width)) - 1
    value &= bits
    return (_UNKNOWN if value == bits else value), width
