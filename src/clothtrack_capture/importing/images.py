"""Decoding of pictures in messages and files (raw, PNG or JPEG) to depth counts or RGB.

Sizes are read from the first bytes and checked against a limit before anything is unpacked.
"""

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8, UInt16

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack.recordings.pictures import SIGNATURE, check_chunks
from clothtrack_capture.importing.intrinsics import MOST_PIXELS

_TO_RGB = {
    "rgb8": (3, None),
    "8uc3": (3, cv2.COLOR_BGR2RGB),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8uc1": (1, cv2.COLOR_GRAY2RGB),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    # OpenCV names a pattern by its second row and column, ROS by its first row and column.
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2RGB),
}
DEPTH_ENCODINGS, GRAY_ENCODINGS = ("16uc1", "mono16", "32fc1"), ("mono8", "8uc1")
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_HEAD_BYTES = 12  # of compressed_depth_image_transport: format and two parameters


def _raw_rows(image: Any, bytes_per_pixel: int) -> UInt8[np.ndarray, "height bytes"]:
    """Return the rows of a sensor_msgs Image without padding."""
    width, height, step = int(image.width), int(image.height), int(image.step)
    row = width * bytes_per_pixel
    data = np.asarray(image.data, dtype=np.uint8)
    if not 0 < width * height <= MOST_PIXELS or step < row or data.size < step * height:
        raise TruncatedError(f"an image of {width} x {height} pixels in {data.size} bytes")
    return data[: step * height].reshape(height, step)[:, :row]


def raw_depth(image: Any) -> Shaped[np.ndarray, "height width"]:
    """Return the numbers of a depth picture in a sensor_msgs Image: uint16 or float32."""
    encoding = str(image.encoding).lower()
    if encoding not in DEPTH_ENCODINGS:
        raise TruncatedError(
            f"encoding {image.encoding!r}; depth is one of {', '.join(DEPTH_ENCODINGS)}"
        )
    kind, size = ("f4", 4) if encoding == "32fc1" else ("u2", 2)
    rows = np.ascontiguousarray(_raw_rows(image, size))
    return rows.view(f"{'>' if image.is_bigendian else '<'}{kind}").astype(kind)


def raw_depth_m(image: Any, unit_m: float) -> Float[np.ndarray, "height width"]:
    """Return the depth of a sensor_msgs Image [m], float32; 0 where there is none.

    Args:
        image: image of counts, or of floats in meters (REP 118).
        unit_m: meters per count [m].
    """
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
    rows = np.ascontiguousarray(_raw_rows(image, channels))
    shape = (rows.shape[0], rows.shape[1] // channels, channels)
    picture = rows.reshape(shape if channels > 1 else shape[:2])
    return picture if conversion is None else _converted(picture, conversion)


def compressed_color(data: bytes) -> UInt8[np.ndarray, "height width 3"]:
    """Return red, green and blue of a complete JPEG or PNG."""
    picture = _decoded(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=picture)


def _decoded(data: bytes, flags: int) -> Any:
    encoded_size(data)
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise TruncatedError(f"a picture that cannot be decoded ({error.err})") from error
    if picture is None:
        raise TruncatedError("a picture that cannot be decoded")
    return picture


def depth_png(message: Any) -> tuple[bytes, tuple[float, float] | None]:
    """Return the PNG in a CompressedImage of depth, and the parameters of depth in floats.

    The transport `compressedDepth` writes 12 bytes before the PNG; for floats, two of them are the
    parameters a and b of a / z + b.
    """
    form, data = str(message.format).lower(), bytes(message.data)
    start = data.find(SIGNATURE, 0, 64)
    if "rvl" in form or start < 0:
        raise TruncatedError(
            f"depth in the format {message.format!r}; only PNG keeps what was measured: record "
            "image_raw or image_raw/compressedDepth"
        )
    if not form.startswith("32fc1"):
        return data[start:], None
    if start < _HEAD_BYTES:
        raise TruncatedError("compressedDepth of floats without its head")
    return data[start:], struct.unpack_from("<ff", data, start - 8)


def inverse_depth(png: bytes, curve: tuple[float, float]) -> Float[np.ndarray, "height width"]:
    """Return depth in floats from a PNG that stores a / z + b."""
    counts, (scale, shift) = png_depth(png), curve
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        numbers = np.float32(scale) / (counts.astype(np.float32) - np.float32(shift))
    return np.where(counts > 0, numbers, np.float32(0))


def gray(data: bytes) -> UInt8[np.ndarray, "height width"]:
    """Return a complete PNG or JPEG as gray."""
    return _decoded(data, cv2.IMREAD_GRAYSCALE)


def png_depth(data: bytes) -> UInt16[np.ndarray, "height width"]:
    """Return the counts of a complete 16-bit gray PNG."""
    if not data.startswith(SIGNATURE):
        raise TruncatedError(
            "depth as a JPEG, which has 8 bits and changes them; write 16-bit gray PNG"
        )
    if data[24:26] != b"\x10\x00":
        encoded_size(data)
        raise TruncatedError(
            f"a depth PNG of {data[24]} bits and color type {data[25]}; 16-bit gray is depth"
        )
    counts = _decoded(data, cv2.IMREAD_UNCHANGED)
    if counts.dtype != np.uint16 or counts.ndim != 2:
        raise TruncatedError("a depth picture that cannot be decoded")
    return counts


def encoded_size(data: bytes) -> tuple[int, int]:
    """Return the width and height in the header of a PNG or JPEG."""
    if data.startswith(SIGNATURE):
        try:
            header = check_chunks(Path("a PNG"), data)
        except InvalidRecordingError as error:
            raise TruncatedError(str(error)) from error
        whole, width, height = True, header.width, header.height
    elif data.startswith(_JPEG_START):
        whole = _JPEG_END in data[-64:]
        width, height = _jpeg_size(data)
    else:
        raise TruncatedError("a picture that is neither PNG nor JPEG")
    if not whole:
        raise TruncatedError("a picture that breaks off")
    if not 0 < width * height <= MOST_PIXELS:
        raise TruncatedError(
            f"a picture of {width} x {height} pixels; at most {MOST_PIXELS} in all"
        )
    return width, height


def _jpeg_size(data: bytes) -> tuple[int, int]:
    position = 2
    while position + 9 < len(data) and data[position] == 0xFF:
        marker, length = (
            data[position + 1],
            int.from_bytes(data[position + 2 : position + 4], "big"),
        )
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, position + 5)
            return width, height
        position += 2 + length if marker != 0xFF else 1
    raise TruncatedError("a JPEG without a size")


def _converted(picture: np.ndarray, conversion: int) -> np.ndarray:
    try:
        return cv2.cvtColor(picture, conversion)
    except cv2.error as error:
        raise TruncatedError(f"a picture that cannot be converted ({error.err})") from error
