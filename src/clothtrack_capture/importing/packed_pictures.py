"""Pictures that a source holds as files: decoded, or taken over as they are."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from clothtrack.errors import TruncatedError
from clothtrack.recordings.pictures import SIGNATURE, png_chunks
from clothtrack_capture.importing.images import compressed_color, encoded_size, png_depth

_DEPTH, _COLOR = b"\x10\x00\x00\x00\x00", b"\x08\x02\x00\x00\x00"
_SAMPLE_BYTES = {_DEPTH: 2, _COLOR: 3}
_PIXELS = (b"IHDR", b"IDAT", b"IEND")
# Say nothing about the pixels; every other chunk (palette, transparency, gamma, orientation, a
# second picture) may, so the picture is decoded then.
_REMARKS = (b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs")
_MOST_FILTER = 4


@dataclass(frozen=True, eq=False)
class PackedPicture:
    """A PNG or JPEG of depth or color that is not decoded yet.

    Attributes:
        data: the file.
        form: bits, color type and the rest of the header of a PNG that may be taken over.
        unpack: decodes it: counts of depth, or red, green and blue.
    """

    data: bytes
    form: bytes
    unpack: Callable[[bytes], np.ndarray]

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]; the whole file is checked for breaks once.

        Raises:
            TruncatedError: the file breaks off, a byte was changed, or it announces too much.
        """
        return encoded_size(self.data)

    def decode(self) -> Shaped[np.ndarray, "height width *channels"]:
        """Return the pixels.

        Raises:
            TruncatedError: the file breaks off, is too large or something else.
        """
        return self.unpack(self.data)

    def plain_png(self) -> bytes | None:
        """Return the file without remarks, if a recording may hold it as it is; None: decode it.

        Checked as far as decoding would: every chunk's checksum, that the pixels are all there
        (and their checksum right), and that each row names a filter that exists.

        Raises:
            TruncatedError: it is such a file, but damaged.
        """
        if not self.data.startswith(SIGNATURE) or self.data[24:29] != self.form:
            return None
        width, height = self.size
        chunks = list(png_chunks(Path("a PNG"), self.data))
        kinds = [kind for kind, _ in chunks]
        if any(kind not in _PIXELS + _REMARKS for kind in kinds) or kinds.count(b"IHDR") != 1:
            return None
        row = 1 + width * _SAMPLE_BYTES[self.form]
        packed = b"".join(self.data[span] for kind, span in chunks if kind == b"IDAT")
        unpacker = zlib.decompressobj()
        try:
            rows = unpacker.decompress(packed, height * row + 1)
        except zlib.error as error:
            raise TruncatedError(f"a PNG whose pixels are damaged ({error})") from error
        if len(rows) != height * row or not unpacker.eof:
            raise TruncatedError(f"a PNG with {len(rows)} bytes of pixels, not {height * row}")
        if np.frombuffer(rows, np.uint8)[::row].max() > _MOST_FILTER:
            raise TruncatedError("a PNG whose pixels are damaged (an unknown filter)")
        if kinds[0] == b"IHDR" and not any(kind in _REMARKS for kind in kinds):
            return self.data
        kept = (self.data[span.start - 8 : span.stop + 4] for kind, span in chunks
                if kind in _PIXELS)  # fmt: skip
        return SIGNATURE + b"".join(kept)


def packed_depth(data: bytes) -> PackedPicture:
    """Return depth as a 16-bit gray PNG."""
    return PackedPicture(data, _DEPTH, png_depth)


def packed_color(data: bytes) -> PackedPicture:
    """Return color as a PNG or JPEG."""
    return PackedPicture(data, _COLOR, compressed_color)
