"""Pictures stored as files in a source, which are decoded or copied unchanged."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from clothtrack.errors import TruncatedError
from clothtrack.recordings.pictures import SIGNATURE, png_chunks
from clothtrack_capture.importing.images import compressed_color, encoded_size, gray, png_depth

_DEPTH, _COLOR = b"\x10\x00\x00\x00\x00", b"\x08\x02\x00\x00\x00"
_SAMPLE_BYTES = {_DEPTH: 2, _COLOR: 3}
_PIXELS = (b"IHDR", b"IDAT", b"IEND")
# These chunks do not affect the pixels. Any other chunk (palette, transparency, gamma, orientation,
# a second picture) may, so the picture is decoded then.
_REMARKS = (b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs")
_MOST_FILTER = 4


@dataclass(frozen=True, eq=False)
class PackedPicture:
    """An encoded PNG or JPEG of depth or color.

    Attributes:
        data: bytes of the file.
        form: bit depth, color type and the rest of the header of a PNG that may be copied.
        unpack: function that decodes it to depth counts, or to red, green and blue.
    """

    data: bytes
    form: bytes
    unpack: Callable[[bytes], np.ndarray]

    @cached_property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]; the file is checked for damage once."""
        return encoded_size(self.data)

    def decode(self) -> Shaped[np.ndarray, "height width *channels"]:
        """Return the pixels."""
        return self.unpack(self.data)

    def plain_png(self) -> bytes | None:
        """Return the PNG without remarks if it can be copied, or None if it must be decoded."""
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
    """Return a packed depth picture, a 16-bit gray PNG."""
    return PackedPicture(data, _DEPTH, png_depth)


def packed_mask(data: bytes) -> PackedPicture:
    """Return a packed mask, a PNG or JPEG that is brighter than black on the cloth."""
    return PackedPicture(data, b"", lambda data: 255 * (gray(data) > 0).astype(np.uint8))


def packed_color(data: bytes) -> PackedPicture:
    """Return a packed color picture, a PNG or JPEG."""
    return PackedPicture(data, _COLOR, compressed_color)
