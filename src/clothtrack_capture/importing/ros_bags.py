"""ROS 1, ROS 2 and RealSense bags as a source: topics, intrinsics and depth unit."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError, TruncatedError
from clothtrack_capture.importing import images
from clothtrack_capture.importing import realsense_bag as realsense
from clothtrack_capture.importing.bag_pickers import bag_paths
from clothtrack_capture.importing.bag_walk import frame_of, open_parts, walk
from clothtrack_capture.importing.containers import Container, Topic
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.intrinsics_file import read_intrinsics
from clothtrack_capture.importing.messages import decode, intrinsics_of, payload
from clothtrack_capture.importing.packed_pictures import packed_color, packed_depth
from clothtrack_capture.importing.source import (
    Content,
    StereoCalibration,
    StreamFrame,
    Streams,
    natural_order,
)
from clothtrack_capture.importing.topics import (
    COMPRESSED,
    base_name,
    choose_color,
    choose_depth,
    info_topic,
)

_PART = re.compile(r"\.(db3|mcap|bag)$")
# Float depth is stored in tenths of a millimeter, finer than any sensor and up to 6.5 m.
_FLOAT_UNIT_M = 1e-4


def bag_files(path: Path) -> list[Path]:
    """Return the files of a bag: the file itself, or the files of a folder in natural order."""
    if not path.is_dir():
        return [path]
    files = [file for file in path.iterdir() if _PART.search(file.name) and file.is_file()]
    return sorted(files, key=lambda file: natural_order(file.name))


class BagSource:
    """A bag in one or several files."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        """Read the bag, choose topics and collect the cameras' calibration."""
        self._path = path
        self._parts, words = open_parts(bag_files(path))
        try:
            self._walk = walk(
                self._parts, pose_topic=options.picker_topic, grip_topic=options.gripper_topic
            )
            if not self._walk.topics:
                raise InvalidRecordingError(f"{path}: no topic at all; record or copy it again")
            self._depth_topic = choose_depth(path, self._walk.topics, options.depth_topic)
            self._color_topic = (
                None
                if options.without_color
                else choose_color(path, self._walk.topics, self._depth_topic, options.color_topic)
            )
            self._encoding = self._first_encoding()
            self._calibration = self._find_calibration(options)
            self.streams = self._find_streams(words, options)
        except BaseException:
            self.close()
            raise

    def depth(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes the counts of a depth picture."""
        data = payload(self._parts[frame.place.part], frame.place)
        return partial(_decode_depth, self._depth_topic, data, self._calibration.depth_unit_m)

    def color(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes red, green and blue."""
        assert self._color_topic is not None
        data = payload(self._parts[frame.place.part], frame.place)
        return partial(_decode_color, self._color_topic, data)

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    def _first(self, topic: Topic) -> tuple[Container, StreamFrame]:
        frames = self._walk.frames.get(topic.name)
        if not frames:
            raise InvalidRecordingError(
                f"{self._path}: not one picture of {topic.name}; record it again, or "
                "name another topic with --depth-topic or --color-topic"
            )
        return self._parts[frames[0].place.part], frames[0]

    def _first_encoding(self) -> str:
        """Return the encoding of depth, from the first readable picture."""
        self._first(self._depth_topic)
        for frame in self._walk.frames[self._depth_topic.name]:
            try:
                data = payload(self._parts[frame.place.part], frame.place)
                message = decode(self._depth_topic, data)
            except TruncatedError:
                continue
            packed = self._depth_topic.kind == COMPRESSED
            return str(message.format if packed else message.encoding).lower()
        raise InvalidRecordingError(
            f"{self._path}: no picture of {self._depth_topic.name} can be read; name another "
            "topic with --depth-topic"
        )

    def _find_calibration(self, options: ImportOptions) -> StereoCalibration:
        unit_m, origin = self._find_unit(options)
        if options.intrinsics is not None:
            file = read_intrinsics(options.intrinsics)
            return file.calibration(unit_m, origin, with_color=self._color_topic is not None)
        depth = self._find_intrinsics(self._depth_topic)
        if self._color_topic is None:
            return StereoCalibration(depth, None, np.eye(4), unit_m, origin)
        try:
            pose = self._find_pose(self._depth_topic, self._color_topic)
        except TruncatedError as error:
            raise InvalidRecordingError(
                f"{self._path}: {error}; give the pose with --intrinsics FILE"
            ) from error
        return StereoCalibration(
            depth, self._find_intrinsics(self._color_topic), pose, unit_m, origin
        )

    def _find_unit(self, options: ImportOptions) -> tuple[float, str]:
        if options.depth_unit_m is not None:
            return options.depth_unit_m, "given by --depth-unit-m"
        topic = self._depth_topic
        unit_m = realsense.depth_unit_m(self._walk.heard, topic)
        if unit_m is not None and unit_m > 0:
            return unit_m, "the sensor's option Depth Units in the recording"
        if self._encoding.startswith("32fc1"):
            return _FLOAT_UNIT_M, "encoding 32FC1: meters (REP 118), stored in 0.1 mm"
        if self._encoding.startswith("16uc1") and not realsense.is_stream(topic):
            return 1e-3, "encoding 16UC1: millimeters (REP 118)"
        raise InvalidRecordingError(
            f"{self._path}: {topic.name} has encoding {self._encoding!r} and nothing says how long "
            "a unit is; give --depth-unit-m (0.001 for millimeters)"
        )

    def _find_intrinsics(self, image: Topic) -> Intrinsics:
        topic = info_topic(self._walk.topics, image)
        if topic is None or topic.name not in self._walk.infos:
            known = ", ".join(sorted(self._walk.infos)) or "none"
            raise InvalidRecordingError(
                f"{self._path}: no camera_info belongs to {image.name} (there: {known}); give "
                "--intrinsics FILE"
            )
        last = base_name(image.name).rpartition("/")[2]
        rectified = "rect" in last and "/device_" not in image.name
        return intrinsics_of(topic.name, self._walk.infos[topic.name], rectified=rectified)

    def _find_pose(self, depth: Topic, color: Topic) -> Float[np.ndarray, "4 4"]:
        pose = realsense.color_from_depth(self._walk.heard, depth, color)
        if pose is not None:
            return pose
        here, there = self._frame(depth), self._frame(color)
        if here == there and not realsense.is_stream(depth):
            return np.eye(4)
        if here and there and self._walk.tree.connects(there, here):
            _, frame = self._first(depth)
            return self._walk.tree.lookup(there, here, np.array([frame.time_ns]))[0]
        raise TruncatedError(
            f"depth is in frame {here!r} and color in frame {there!r}, and no TF ties them"
        )

    def _frame(self, topic: Topic) -> str:
        container, frame = self._first(topic)
        return frame_of(container, topic, frame.place)

    def _find_streams(self, words: str, options: ImportOptions) -> Streams:
        color = self._color_topic
        origins = {"depth": self._depth_topic.name}
        if color is not None:
            self._first(color)
            origins["color"] = color.name
        camera_frame = self._frame(color or self._depth_topic)
        world = None
        if options.world_frame is not None:
            world = self._world_from_camera(camera_frame, options.world_frame)
        picker = bag_paths(self._path, self._walk, options, camera_frame)
        recorder = " of the RealSense SDK" if realsense.is_stream(self._depth_topic) else ""
        return Streams(
            kind=words + recorder,
            calibration=self._calibration,
            depth=self._walk.frames[self._depth_topic.name],
            color=None if color is None else self._walk.frames[color.name],
            origins={**origins, **picker.origins},
            notes=picker.notes,
            paths=picker.paths,
            path_frame=picker.frame,
            path_start_ns=picker.start_ns,
            world_from_camera=world,
        )

    def _world_from_camera(self, camera: str, world: str) -> Float[np.ndarray, "4 4"]:
        tree: Any = self._walk.tree
        if not camera or not tree.connects(world, camera):
            raise InvalidConfigError(
                f"{self._path}: no TF ties the camera's frame {camera!r} to --world-frame "
                f"{world!r}; frames: {', '.join(tree.frames) or 'none'}"
            )
        _, frame = self._first(self._color_topic or self._depth_topic)
        return tree.lookup(world, camera, np.array([frame.time_ns]))[0]


def _decode_depth(topic: Topic, data: bytes, unit_m: float) -> Content:
    message = decode(topic, data)
    if topic.kind == COMPRESSED:
        png, curve = images.depth_png(message)
        return packed_depth(png) if curve is None else images.inverse_depth(png, curve, unit_m)
    return images.raw_depth(message, unit_m)


def _decode_color(topic: Topic, data: bytes) -> Content:
    message = decode(topic, data)
    if topic.kind == COMPRESSED:
        return packed_color(bytes(message.data))
    return images.raw_color(message)
