"""Decoding of pictures in messages and files (raw, PNG or JPEG) to depth counts or RGB.

Sizes are read from the first bytes and checked against a limit before anything is unpacked. A plain
PNG in a source is copied unchanged.
"""

import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8, UInt16

from clothtrack.errors import TruncatedError
from clothtrack.recordings.pictures import SIGNATURE
from clothtrack_capture.importing.intrinsics import MOST_PIXELS

_TO_RGB = {
    "rgb8": (3, None),
    **dict.fromkeys(("8uc3", "bgr8"), (3, cv2.COLOR_BGR2RGB)),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    **dict.fromkeys(("mono8", "8uc1"), (1, cv2.COLOR_GRAY2RGB)),
    **dict.fromkeys(("uyvy", "yuv422"), (2, cv2.COLOR_YUV2RGB_UYVY)),
    **dict.fromkeys(("yuyv", "yuv422_yuy2"), (2, cv2.COLOR_YUV2RGB_YUY2)),
    # OpenCV names a pattern by its second row and column, ROS by its first row and column.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
}
DEPTH_ENCODINGS, GRAY_ENCODINGS = ("16uc1", "mono16", "32fc1"), ("mono8", "8uc1")
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_DEPTH, _COLOR = b"\x10\x00\x00\x00\x00", b"\x08\x02\x00\x00\x00"
_SAMPLE_BYTES = {_DEPTH: 2, _COLOR: 3}
_PIXELS = (b"IHDR", b"IDAT", b"IEND")
# These chunks do not affect the pixels. Any other chunk (palette, transparency, gamma, orientation,
# a second picture) may, so the picture is decoded then.
_REMARKS = (b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs")
_MOST_FILTER = 4


def _raw_rows(image: Any, bytes_per_pixel: int) -> UInt8[np.ndarray, "height bytes"]:
    """Return the rows of a sensor_msgs Image without padding."""
    width, height, step = int(image.width), int(image.height), int(image.step)
    row = width * bytes_per_pixel
    data = np.asarray(image.data, dtype=np.uint8)
    if not 0 < width * height <= MOST_PIXELS or step < row or data.size < step * height:
        raise TruncatedError(f"an image of {width} x {height} pixels in {data.size} bytes")
    return np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])


def raw_depth(image: Any) -> Shaped[np.ndarray, "height width"]:
    """Return the numbers of a depth picture in a sensor_msgs Image: uint16 or float32."""
    encoding = str(image.encoding).lower()
    if encoding not in DEPTH_ENCODINGS:
        known = ", ".join(DEPTH_ENCODINGS)
        raise TruncatedError(f"encoding {image.encoding!r}; depth is one of {known}")
    order, kind = ">" if image.is_bigendian else "<", "f4" if encoding == "32fc1" else "u2"
    return _raw_rows(image, int(kind[1])).view(order + kind).astype(kind)


def raw_depth_m(image: Any, unit_m: float) -> Float[np.ndarray, "height width"]:
    """Return the depth of a sensor_msgs Image of meters or counts [m]; 0 where there is none."""
    numbers = raw_depth(image)
    if numbers.dtype.kind == "u":
        return np.multiply(numbers, np.float32(unit_m), dtype=np.float32)
    return np.where(np.isfinite(numbers) & (numbers > 0), numbers, np.float32(0))


def raw_color(image: Any) -> UInt8[np.ndarray, "height width 3"]:
    """Return red, green and blue of a sensor_msgs Image."""
    encoding = str(image.encoding).lower()
    if encoding not in _TO_RGB:
        raise TruncatedError(f"encoding {image.encoding!r}; known are {', '.join(_TO_RGB)}")
    channels, conversion = _TO_RGB[encoding]
    rows = _raw_rows(image, channels)
    picture = rows if channels == 1 else rows.reshape(len(rows), -1, channels)
    return picture if conversion is None else to_rgb(picture, conversion)


def to_rgb(picture: np.ndarray, conversion: int) -> UInt8[np.ndarray, "height width 3"]:
    """Return a picture converted by OpenCV."""
    with suppress(cv2.error):
        return cv2.cvtColor(picture, conversion)
    raise TruncatedError(f"a picture of shape {picture.shape} that cannot be converted")


def png_depth(data: bytes) -> UInt16[np.ndarray, "height width"]:
    """Return the counts of a complete 16-bit gray PNG."""
    width, height = encoded_size(data)
    if not data.startswith(SIGNATURE):
        raise TruncatedError("depth as a JPEG, which changes it; write 16-bit gray PNG")
    counts = _decoded(data, cv2.IMREAD_UNCHANGED)
    if counts.dtype != np.uint16 or counts.shape != (height, width):
        words = f"a PNG of {data[24]} bits and color type {data[25]}"
        raise TruncatedError(f"depth as {words}; write 16-bit gray PNG")
    return counts


def _rgb(data: bytes) -> UInt8[np.ndarray, "height width 3"]:
    picture = _decoded(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=picture)


def _mask(data: bytes) -> UInt8[np.ndarray, "height width"]:
    return 255 * (_decoded(data, cv2.IMREAD_GRAYSCALE) > 0).astype(np.uint8)


def _decoded(data: bytes, flags: int) -> Any:
    encoded_size(data)
    with suppress(cv2.error):
        if (picture := cv2.imdecode(np.frombuffer(data, np.uint8), flags)) is not None:
            return picture
    raise TruncatedError("a picture that cannot be decoded")


def _chunks(data: bytes) -> list[tuple[bytes, slice]]:
    """Return the kind of every chunk of a PNG and the slice of its content; refuse damage."""
    chunks, position = [], len(SIGNATURE)
    while position + 12 <= len(data):
        stop = position + 8 + int.from_bytes(data[position : position + 4], "big")
        if zlib.crc32(data[position + 4 : stop]) != int.from_bytes(data[stop : stop + 4], "big"):
            raise TruncatedError(f"a PNG that is damaged at byte {position}")
        chunks.append((data[position + 4 : position + 8], slice(position + 8, stop)))
        position = stop + 4
    if not chunks or chunks[-1][0] != b"IEND":
        raise TruncatedError("a PNG that breaks off")
    return chunks


def encoded_size(data: bytes) -> tuple[int, int]:
    """Return the width and height in the header of a PNG or JPEG."""
    if data.startswith(SIGNATURE) and len(data) > 28:
        width, height = struct.unpack(">II", data[16:24])
    elif data.startswith(_JPEG_START) and _JPEG_END in data[-64:]:
        width, height = _jpeg_size(data)
    else:
        raise TruncatedError("a picture that is neither PNG nor JPEG, or breaks off")
    if not 0 < width * height <= MOST_PIXELS:
        raise TruncatedError(f"a picture of {width} x {height} pixels; at most {MOST_PIXELS}")
    return width, height


def _jpeg_size(data: bytes) -> tuple[int, int]:
    position = 2
    while position + 9 < len(data) and data[position] == 0xFF:
        marker, length = struct.unpack_from(">BH", data, position + 1)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, position + 5)
            return width, height
        position += 2 + length if marker != 0xFF else 1
    raise TruncatedError("a JPEG without a size")


@dataclass(frozen=True, eq=False)
class PackedPicture:
    """An encoded PNG or JPEG of depth or color, which is decoded or copied unchanged."""

    data: bytes
    form: bytes  # bit depth, color type and the rest of the header of a PNG that may be copied
    unpack: Callable[[bytes], np.ndarray]  # to depth counts, or to red, green and blue

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in the header [pixels]."""
        return encoded_size(self.data)

    def decode(self) -> Shaped[np.ndarray, "height width *channels"]:
        """Return the pixels."""
        return self.unpack(self.data)

    def plain_png(self) -> bytes | None:
        """Return the PNG without remarks if it can be copied, or None if it must be decoded."""
        if not self.data.startswith(SIGNATURE) or self.data[24:29] != self.form:
            return None
        (width, height), chunks = self.size, _chunks(self.data)
        kinds = [kind for kind, _ in chunks]
        if {*kinds} - {*_PIXELS, *_REMARKS} or kinds.count(b"IHDR") != 1:
            return None
        row = 1 + width * _SAMPLE_BYTES[self.form]
        packed = b"".join(self.data[span] for kind, span in chunks if kind == b"IDAT")
        unpacker, rows = zlib.decompressobj(), b""
        with suppress(zlib.error):
            rows = unpacker.decompress(packed, height * row + 1)
        whole = len(rows) == height * row and unpacker.eof
        if not whole or max(rows[::row]) > _MOST_FILTER:
            raise TruncatedError("a PNG whose pixels are damaged")
        if not {*kinds} & {*_REMARKS}:
            return self.data
        kept = (span for kind, span in chunks if kind in _PIXELS)
        return SIGNATURE + b"".join(self.data[one.start - 8 : one.stop + 4] for one in kept)


def packed_depth(data: bytes) -> PackedPicture:
    """Return a packed depth picture, a 16-bit gray PNG."""
    return PackedPicture(data, _DEPTH, png_depth)


def packed_mask(data: bytes) -> PackedPicture:
    """Return a packed mask, a PNG or JPEG that is brighter than black on the cloth."""
    return PackedPicture(data, b"", _mask)


def packed_color(data: bytes) -> PackedPicture:
    """Return a packed color picture, a PNG or JPEG."""
    return PackedPicture(data, _COLOR, _rgb)


def compressed_depth(message: Any) -> PackedPicture | Float[np.ndarray, "height width"]:
    """Return the depth in a CompressedImage, decoded only if the PNG in it holds a / z + b."""
    form, data = str(message.format).lower(), bytes(message.data)
    start = data.find(SIGNATURE, 0, 64)
    if "rvl" in form or start < 0:
        raise TruncatedError(
            f"depth in the format {message.format!r}; only PNG keeps what was measured: record "
            "image_raw or image_raw/compressedDepth"
        )
    if not form.startswith("32fc1"):
        return packed_depth(data[start:])
    if start < 8:
        raise TruncatedError("compressedDepth of floats without its head")
    # The transport `compressedDepth` writes 12 bytes before the PNG: format, a and b.
    scale, shift = np.array(struct.unpack_from("<ff", data, start - 8), dtype=np.float32)
    counts = png_depth(data[start:])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        numbers = scale / (counts.astype(np.float32) - shift)
    return np.where(counts > 0, numbers, np.float32(0))
