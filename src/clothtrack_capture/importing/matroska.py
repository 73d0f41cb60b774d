"""Matroska files, read by FFmpeg: tracks, tags, attachments and the position of every picture.

FFmpeg reads the file once to list the pictures, which are fetched later from their positions. From
a truncated file, all complete pictures are used.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import av
import av.logging
from av.container import InputContainer
from av.error import FFmpegError
from av.stream import AttachmentStream

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.importing.containers import BagFile

MAGIC = b"\x1a\x45\xdf\xa3"
_BLOCK_HEAD = 4
"""Number of bytes of a block before its picture: track number, time and flags."""


@dataclass(frozen=True)
class Track:
    """A video track.

    Attributes:
        number: track number used in blocks.
        name: track name, such as "DEPTH".
        letters: FourCC of the pictures: "MJPG", "NV12", ...
        tags: value per tag name of this track.
        width: picture width [pixels].
        height: picture height [pixels].
    """

    number: int
    name: str
    letters: str
    tags: dict[str, str]
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Block:
    """One picture: its track number, time [ns] and position in the file."""

    track: int
    time_ns: int
    offset: int
    size: int


class Matroska:
    """A Matroska file indexed by FFmpeg; close it after use.

    Attributes:
        tracks: all video tracks.
        tags: value per tag name, including tags of tracks and attachments.
        attachments: content per file name.
        blocks: all complete pictures, in file order.
        damage: description of damage; empty for an intact file.
    """

    def __init__(self, path: Path) -> None:
        """Index a file."""
        self.tracks: list[Track] = []
        self.tags: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self.blocks: list[Block] = []
        self._file = BagFile(path)
        with _logged_errors() as errors:
            try:
                with av.open(
                    f"file:{path}", format="matroska", metadata_errors="replace"
                ) as container:
                    self._learn(container)
                    self._walk(container)
            except FFmpegError as error:
                errors.append(error.strerror)
            except BaseException:
                self.close()
                raise
        self.damage = "; ".join(dict.fromkeys(errors))

    def fetch(self, block: Block) -> bytes:
        """Return the bytes of a block."""
        return self._file.read(block.offset, block.size)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _learn(self, container: InputContainer) -> None:
        self.tags |= container.metadata
        for stream in container.streams:
            self.tags |= stream.metadata
            if isinstance(stream, AttachmentStream):
                self.attachments[stream.name or ""] = stream.data
        for stream in container.streams.video:
            context = stream.codec_context
            if context is None:  # of a kind that FFmpeg does not know
                continue
            letters = "MJPG" if context.name == "mjpeg" else context.codec_tag
            self.tracks.append(
                Track(
                    number=stream.index,
                    name=stream.metadata.get("title", ""),
                    letters=letters.upper(),
                    tags=stream.metadata,
                    width=context.width,
                    height=context.height,
                )
            )

    def _walk(self, container: InputContainer) -> None:
        names = {track.number: track.name for track in self.tracks}
        for packet in container.demux(list(names)) if names else ():
            if not packet.size or packet.pts is None or packet.pos is None:
                continue
            track, start = packet.stream.index, packet.pos + _BLOCK_HEAD
            time_ns = round(packet.pts * packet.time_base * 10**9)
            head = bytes(memoryview(packet)[:16])
            if self._file.read(start, len(head)) != head:
                raise InvalidRecordingError(
                    f"{self._file.path}: the container has compressed the pictures of track "
                    f"{names[track]!r} once more; write them anew, such as with "
                    "ffmpeg -i OLD.mkv -map 0 -codec copy NEW.mkv"
                )
            self.blocks.append(Block(track, time_ns, start, packet.size))


@contextmanager
def _logged_errors() -> Iterator[list[str]]:
    """Yield a list of FFmpeg's error messages inside the block."""
    before, errors = av.logging.get_level(), list[str]()
    av.logging.set_level(av.logging.ERROR)
    try:
        with av.logging.Capture(local=True) as lines:
            yield errors
        errors += [text.strip() for _, _, text in lines]
    finally:
        av.logging.set_level(before)
