"""Azure Kinect and Orbbec Femto recordings (`.mkv`) as a source."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import MOST_PIXELS
from clothtrack_capture.importing.intrinsics_file import read_intrinsics
from clothtrack_capture.importing.kinect_calibration import kinect_intrinsics
from clothtrack_capture.importing.matroska import MAGIC, Matroska, Track
from clothtrack_capture.importing.packed_pictures import packed_color
from clothtrack_capture.importing.source import Content, StereoCalibration, StreamFrame, Streams
from clothtrack_capture.importing.units import DepthUnit

_CALIBRATION = "calibration.json"
_RAW_COLOR = {"NV12": (1.5, cv2.COLOR_YUV2RGB_NV12), "YUY2": (2.0, cv2.COLOR_YUV2RGB_YUY2),
              "BGRA": (4.0, cv2.COLOR_BGRA2RGB)}  # fmt: skip


def is_kinect(path: Path) -> bool:
    """Return whether a file is Matroska."""
    with path.open("rb") as file:
        return file.read(4) == MAGIC


class KinectSource:
    """A Matroska file with the tracks COLOR and DEPTH and an attached calibration."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        """Read the file's index and the calibration."""
        self._path = path
        self._file = Matroska(path)
        try:
            self.streams = self._find(options)
        except BaseException:
            self.close()
            raise

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture."""
        data = self._file.fetch(frame.place)
        if kind == "depth":
            return partial(_depth, data, self._depth_track.width, self._depth_track.height)
        assert self._color_track is not None
        return partial(_color, data, self._color_track)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _find(self, options: ImportOptions) -> Streams:
        frames: dict[int, list[StreamFrame]] = {}
        for block in self._file.blocks:
            frames.setdefault(block.track, []).append(StreamFrame(block.time_ns, block))
        notes = []
        if self._file.damage:
            whole = sum(map(len, frames.values()))
            notes.append(
                f"the file breaks off or is damaged ({self._file.damage}); {whole} whole pictures "
                "were saved"
            )
        depth_track = self._track("DEPTH")
        if depth_track is None:
            names = ", ".join(repr(track.name) for track in self._file.tracks) or "none"
            lost = "".join(f" ({note})" for note in notes)
            raise InvalidRecordingError(
                f"{self._path}: no track DEPTH{lost}; tracks: {names}; record with k4arecorder or "
                "OrbbecViewer, depth switched on"
            )
        self._depth_track = depth_track
        self._color_track = None if options.without_color else self._track("COLOR")
        calibration, lens_notes = self._calibration(options)
        notes += lens_notes
        color = None if self._color_track is None else frames.get(self._color_track.number, [])
        origins = {"depth": f"track {depth_track.name}"}
        if self._color_track is not None:
            origins["color"] = f"track {self._color_track.name}"
        if options.picker_topic or options.picker_frame or options.gripper_topic:
            notes.append("a Kinect recording has no topics: the picker's path is not in it")
        return Streams(
            kind="Azure Kinect / Orbbec Femto recording (Matroska)",
            calibration=calibration,
            unit=DepthUnit(1e-3, "the format: millimeters")
            if options.depth_unit_m is None
            else DepthUnit(options.depth_unit_m, "given by --depth-unit-m"),
            ask_unit="",
            depth=frames.get(depth_track.number, []),
            color=color,
            origins=origins,
            notes=notes,
        )

    def _track(self, name: str) -> Track | None:
        for track in self._file.tracks:
            if track.name.upper() == name or f"K4A_{name}_TRACK" in track.tags:
                pixels = track.width * track.height
                if not 0 < pixels <= MOST_PIXELS:
                    raise InvalidRecordingError(
                        f"{self._path}: track {track.name!r} of {track.width} x {track.height} "
                        "pixels; the file is damaged, copy or record it again"
                    )
                return track
        return None

    def _calibration(self, options: ImportOptions) -> tuple[StereoCalibration, list[str]]:
        if options.intrinsics is not None:
            file = read_intrinsics(options.intrinsics)
            return file.calibration(with_color=self._color_track is not None), file.notes
        content = self._file
        name = content.tags.get("K4A_CALIBRATION_FILE", _CALIBRATION)
        text = content.attachments.get(name, content.attachments.get(_CALIBRATION))
        if text is None:
            raise InvalidRecordingError(
                f"{self._path}: no attached calibration, so no intrinsics are known (attached: "
                f"{', '.join(content.attachments) or 'nothing'}); give --intrinsics FILE"
            )
        track = self._color_track
        depth, color, pose = kinect_intrinsics(
            self._path,
            text,
            (self._depth_track.width, self._depth_track.height),
            None if track is None else (track.width, track.height),
        )
        return StereoCalibration(depth, color, pose, f"the attached {name}"), []


def _depth(data: bytes, width: int, height: int) -> np.ndarray:
    if len(data) != 2 * width * height:
        raise TruncatedError(f"a depth picture of {len(data)} bytes for {width} x {height} pixels")
    return np.frombuffer(data, ">u2").reshape(height, width).astype(np.uint16)


def _color(data: bytes, track: Track) -> Content:
    letters = track.letters
    if letters in ("MJPG", "JPEG"):
        return packed_color(data)
    if letters not in _RAW_COLOR:
        raise TruncatedError(
            f"color of the kind {letters!r}; known are MJPG, {', '.join(_RAW_COLOR)}"
        )
    share, conversion = _RAW_COLOR[letters]
    width, height = track.width, track.height
    if len(data) != int(share * width * height):
        raise TruncatedError(f"a color picture of {len(data)} bytes for {width} x {height} pixels")
    pixels = np.frombuffer(data, np.uint8)
    shape = (height * 3 // 2, width) if letters == "NV12" else (height, width, int(share))
    try:
        return cv2.cvtColor(pixels.reshape(shape), conversion)
    except (cv2.error, ValueError) as error:
        raise TruncatedError("a color picture that cannot be converted") from error
