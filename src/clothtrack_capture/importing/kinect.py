"""Azure Kinect and Orbbec Femto recordings (`.mkv`) as a source.

FFmpeg reads the file once to list the pictures, which are fetched later from their positions. From
a truncated file, all complete pictures are used. The attached JSON holds each camera's intrinsics
for its full sensor, as shares of its sides, with the first pixel's outer corner at (0, 0); a mode
bins and crops the sensor (`mode_specific_calibration.c` of the Azure Kinect Sensor SDK).
"""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import av
import av.logging
import cv2
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.stream import AttachmentStream
from jaxtyping import Float

from clothtrack.errors import ClothTrackError, InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.containers import FileOnDemand
from clothtrack_capture.importing.images import packed_color, to_rgb
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import Intrinsics, StereoCalibration, read_intrinsics
from clothtrack_capture.importing.source import (
    TOPIC_OPTIONS,
    Content,
    StreamFrame,
    Streams,
    unused,
)
from clothtrack_capture.importing.transforms import rigid
from clothtrack_capture.importing.units import DepthUnit

_MAGIC = b"\x1a\x45\xdf\xa3"
_BLOCK_HEAD = 4  # bytes of a block before its picture: track number, time and flags
_CALIBRATION = "calibration.json"
_RAW_COLOR = {"NV12": (1, cv2.COLOR_YUV2RGB_NV12), "YUY2": (2, cv2.COLOR_YUV2RGB_YUY2),
              "BGRA": (4, cv2.COLOR_BGRA2RGB)}  # fmt: skip
# Per picture size: the sensor after binning and the first pixel of the crop, (along x, along y).
# No two modes have the same size. Of depth: narrow binned, narrow, wide binned, wide.
_MODES = {
    (320, 288): ((512, 512), (96, 90)), (640, 576): ((1024, 1024), (192, 180)),
    (512, 512): ((512, 512), (0, 0)), (1024, 1024): ((1024, 1024), (0, 0)),
    (1280, 720): ((1280, 960), (0, 120)), (1920, 1080): ((1920, 1440), (0, 180)),
    (2560, 1440): ((2560, 1920), (0, 240)), (2048, 1536): ((2048, 1536), (0, 0)),
    (3840, 2160): ((3840, 2880), (0, 360)), (4096, 3072): ((4096, 3072), (0, 0)),
}  # fmt: skip
# Old calibrations are for a 16:9 picture cropped from the 4:3 sensor.
_LEGACY = ((4096, 2304), (0, -384), (4096, 3072))
_DEPTH_PLACE, _COLOR_PLACE = "CALIBRATION_CameraLocationD0", "CALIBRATION_CameraLocationPV0"
_MODEL = "CALIBRATION_LensDistortionModelBrownConrady"


def is_kinect(path: Path) -> bool:
    """Return whether a file is Matroska."""
    with path.open("rb") as file:
        return file.read(4) == _MAGIC


class Track(NamedTuple):
    """A video track."""

    number: int
    name: str  # "DEPTH"
    letters: str  # FourCC of the pictures: "MJPG", "NV12", ...
    tags: dict[str, str]
    size: tuple[int, int]  # width and height [pixels]


class Matroska:
    """A Matroska file indexed by FFmpeg; close it after use."""

    def __init__(self, path: Path) -> None:
        self.tracks: list[Track] = []
        self.tags: dict[str, str] = {}  # with those of tracks and attachments
        self.attachments: dict[str, bytes] = {}
        self.frames: dict[int, list[StreamFrame]] = {}  # complete pictures per track number
        self._file = FileOnDemand(path)
        self.close = self._file.close
        with _logged_errors() as errors:
            try:
                how = {"format": "matroska", "metadata_errors": "replace"}
                with av.open(f"file:{path}", **how) as container:
                    self._learn(container)
                    self._walk(path, container)
            except FFmpegError as error:
                errors.append(error.strerror)
            except BaseException:
                self.close()
                raise
        self.damage = "; ".join(dict.fromkeys(errors))  # "" for an intact file

    def fetch(self, frame: StreamFrame) -> bytes:
        """Return the bytes of a picture."""
        return self._file.read(*frame.place)

    def _learn(self, container: InputContainer) -> None:
        self.tags |= container.metadata
        for stream in container.streams:
            self.tags |= stream.metadata
            if isinstance(stream, AttachmentStream):
                self.attachments[stream.name or ""] = stream.data
        for stream in container.streams.video:
            context, tags = stream.codec_context, stream.metadata
            if context is None:  # of a kind that FFmpeg does not know
                continue
            letters = "MJPG" if context.name == "mjpeg" else context.codec_tag.upper()
            size = context.width, context.height
            self.tracks.append(Track(stream.index, tags.get("title", ""), letters, tags, size))

    def _walk(self, path: Path, container: InputContainer) -> None:
        names = {track.number: track.name for track in self.tracks}
        for packet in container.demux(list(names)) if names else ():
            if not packet.size or packet.pts is None or packet.pos is None:
                continue
            track, start = packet.stream.index, packet.pos + _BLOCK_HEAD
            time_ns = round(packet.pts * packet.time_base * 10**9)
            head = bytes(memoryview(packet)[:16])
            if self._file.read(start, len(head)) != head:
                raise InvalidRecordingError(
                    f"{path}: the container has compressed track {names[track]!r} once more; write "
                    "it anew: ffmpeg -i OLD.mkv -map 0 -codec copy NEW.mkv"
                )
            self.frames.setdefault(track, []).append(StreamFrame(time_ns, (start, packet.size)))


@contextmanager
def _logged_errors() -> Iterator[list[str]]:
    """Yield a list of FFmpeg's error messages inside the block."""
    before, errors = av.logging.get_level(), list[str]()
    av.logging.set_level(av.logging.ERROR)
    av.logging.set_skip_repeated(False)  # or a second damaged file would seem whole
    try:
        with av.logging.Capture(local=True) as lines:
            yield errors
        errors += [text.strip() for _, _, text in lines]
    finally:
        av.logging.set_level(before)
        av.logging.set_skip_repeated(True)


class KinectSource:
    """A Matroska file with the tracks COLOR and DEPTH and an attached calibration."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        """Read the file's index and the calibration."""
        self._path, self._file = path, Matroska(path)
        self.close = self._file.close
        try:
            self.streams = self._find(options)
        except BaseException:
            self.close()
            raise

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture."""
        decode, track = (_depth, self._depth) if kind == "depth" else (_color, self._color)
        return partial(decode, self._file.fetch(frame), track)

    def _find(self, options: ImportOptions) -> Streams:
        content, notes = self._file, list[str]()
        if content.damage:
            whole = sum(map(len, content.frames.values()))
            notes.append(f"the file breaks off or is damaged ({content.damage}); {whole} whole "
                         "pictures were saved")  # fmt: skip
        depth = self._track("DEPTH")
        if depth is None:
            names = ", ".join(repr(track.name) for track in content.tracks) or "none"
            lost = "".join(f" ({note})" for note in notes)
            raise InvalidRecordingError(
                f"{self._path}: no track DEPTH{lost}; tracks: {names}; record with k4arecorder or "
                "OrbbecViewer, depth switched on"
            )
        self._depth, self._color = depth, None if options.without_color else self._track("COLOR")
        tracks = {"depth": depth} | ({} if self._color is None else {"color": self._color})
        calibration, lens_notes = self._calibration(options)
        notes += lens_notes
        notes += unused(options, "has no topics; --picker-csv gives a path", *TOPIC_OPTIONS, "fps")
        unit = DepthUnit(1e-3, "the format: millimeters")
        if options.depth_unit_m is not None:
            unit = DepthUnit(options.depth_unit_m, "given by --depth-unit-m")
        frames = {kind: content.frames.get(track.number, []) for kind, track in tracks.items()}
        return Streams(
            kind="Azure Kinect / Orbbec Femto recording (Matroska)",
            calibration=calibration,
            unit=unit,
            ask_unit="",
            depth=frames["depth"],
            color=frames.get("color"),
            origins={kind: f"track {track.name}" for kind, track in tracks.items()},
            notes=notes,
        )

    def _track(self, name: str) -> Track | None:
        return next((track for track in self._file.tracks if track.name.upper() == name
                     or f"K4A_{name}_TRACK" in track.tags), None)  # fmt: skip

    def _calibration(self, options: ImportOptions) -> tuple[StereoCalibration, list[str]]:
        color, content = self._color, self._file
        if options.intrinsics is not None:
            file = read_intrinsics(options.intrinsics)
            return file.calibration(with_color=color is not None), file.notes
        name = content.tags.get("K4A_CALIBRATION_FILE", _CALIBRATION)
        text = content.attachments.get(name, content.attachments.get(_CALIBRATION))
        if text is None:
            raise InvalidRecordingError(
                f"{self._path}: no attached calibration, so no intrinsics are known (attached: "
                f"{', '.join(content.attachments) or 'nothing'}); give --intrinsics FILE"
            )
        sizes = self._depth.size, None if color is None else color.size
        lenses = kinect_intrinsics(self._path, text, *sizes)
        return StereoCalibration(*lenses, f"the attached {name}"), []


def kinect_intrinsics(
    path: Path, text: bytes, depth_size: tuple[int, int], color_size: tuple[int, int] | None
) -> tuple[Intrinsics, Intrinsics | None, Float[np.ndarray, "4 4"]]:
    """Return the intrinsics of depth and color and the transform from depth to color camera [m]."""
    try:
        cameras = json.loads(text.split(b"\0")[0])["CalibrationInformation"]["Cameras"]
        by_place = {camera["Location"]: camera for camera in cameras}
        depth = _intrinsics(by_place[_DEPTH_PLACE], depth_size)
        if color_size is None:
            return depth, None, np.eye(4)
        color = _intrinsics(by_place[_COLOR_PLACE], color_size)
        # Each pose leads from the device to the camera.
        poses = (by_place[place]["Rt"] for place in (_DEPTH_PLACE, _COLOR_PLACE))
        depth_pose, color_pose = (rigid(pose["Rotation"], pose["Translation"]) for pose in poses)
    except (
        KeyError, TypeError, ValueError, AttributeError, RecursionError, ClothTrackError
    ) as error:  # fmt: skip
        raise InvalidRecordingError(
            f"{path}: the attached calibration cannot be used ({type(error).__name__}: {error}); "
            "give the intrinsics with --intrinsics FILE"
        ) from error
    return depth, color, color_pose @ np.linalg.inv(depth_pose)


def _intrinsics(camera: dict[str, Any], size: tuple[int, int]) -> Intrinsics:
    if size not in _MODES:
        known = ", ".join(f"{width} x {height}" for width, height in _MODES)
        raise ValueError(f"pictures of {size[0]} x {size[1]} pixels; the modes have {known}")
    binned, crop = _MODES[size]
    lens = camera["Intrinsics"]
    if lens["ModelType"] != _MODEL:
        raise ValueError(f"lens model {lens['ModelType']}")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = map(float, lens["ModelParameters"])
    if int(camera["SensorWidth"]) * 9 == int(camera["SensorHeight"]) * 16:
        (across, down), (left, above), (full_width, full_height) = _LEGACY
        cx, fx = (cx * across - left) / full_width, fx * across / full_width
        cy, fy = (cy * down - above) / full_height, fy * down / full_height
    cx, cy = cx * binned[0] - crop[0] - 0.5, cy * binned[1] - crop[1] - 0.5
    fx, fy = fx * binned[0], fy * binned[1]
    return Intrinsics(*size, fx, fy, cx, cy, (k1, k2, p1, p2, k3, k4, k5, k6))


def _depth(data: bytes, track: Track) -> np.ndarray:
    width, height = track.size
    if len(data) != 2 * width * height:
        raise TruncatedError(f"a depth picture of {len(data)} bytes for {width} x {height} pixels")
    return np.frombuffer(data, ">u2").reshape(height, width).astype(np.uint16)


def _color(data: bytes, track: Track) -> Content:
    letters, (width, height) = track.letters, track.size
    if letters in ("MJPG", "JPEG"):
        return packed_color(data)
    if letters not in _RAW_COLOR:
        raise TruncatedError(f"color is {letters!r}; known are MJPG, {', '.join(_RAW_COLOR)}")
    channels, conversion = _RAW_COLOR[letters]
    shape = (height * 3 // 2, width) if letters == "NV12" else (height, width, channels)
    if len(data) != math.prod(shape):
        raise TruncatedError(f"a color picture of {len(data)} bytes for {width} x {height} pixels")
    return to_rgb(np.frombuffer(data, np.uint8).reshape(shape), conversion)
