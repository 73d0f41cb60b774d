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
from clothtrack_capture.importing.bag_walk import frame_of, in_time_order, open_parts, walk
from clothtrack_capture.importing.containers import Container, Topic
from clothtrack_capture.importing.images import packed_color, packed_depth
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import Intrinsics, StereoCalibration, read_intrinsics
from clothtrack_capture.importing.messages import decode, intrinsics_of, payload
from clothtrack_capture.importing.source import (
    Content,
    StreamFrame,
    Streams,
    natural_order,
    unused,
)
from clothtrack_capture.importing.topics import (
    COMPRESSED,
    PNG_DEPTH,
    base_name,
    choose_color,
    choose_depth,
    info_topic,
    left_out,
)
from clothtrack_capture.importing.units import DepthUnit

_PART = re.compile(r"\.(db3|mcap|bag)$")
# A camera that moves by more during a recording is not a fixed one.
_MOST_MOVED_M, _MOST_TURNED = 0.01, np.radians(1.0)


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
            self._parts = in_time_order(self._parts)
            self._walk = walk(
                path, self._parts, pose_topic=options.picker_topic,
                grip_topic=options.gripper_topic, written=options.stamps == "written",
            )  # fmt: skip
            topics = self._walk.topics
            if not topics:
                raise InvalidRecordingError(f"{path}: no topic at all; record or copy it again")
            self._depth_topic = choose_depth(path, topics, options.depth_topic, self._encoding_of)
            self._color_topic = (
                None
                if options.without_color
                else choose_color(
                    path, topics, self._depth_topic, options.color_topic, self._encoding_of
                )
            )
            self.streams = self._find_streams(words, options)
        except BaseException:
            self.close()
            raise

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture."""
        data = payload(self._parts[frame.place.part], frame.place)
        if kind == "depth":
            return partial(_decode_depth, self._depth_topic, data)
        assert self._color_topic is not None
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

    def _encoding_of(self, topic: Topic) -> str:
        """Return the encoding of a topic's pictures, from the first readable one; "" if none is."""
        for frame in self._walk.frames.get(topic.name, ()):
            try:
                data = payload(self._parts[frame.place.part], frame.place)
                message = decode(topic, data)
            except TruncatedError:
                continue
            if topic.kind != COMPRESSED:
                return str(message.encoding).lower()
            form, start = str(message.format).lower(), bytes(message.data[:32])
            is_depth = start.startswith(images.SIGNATURE) and start[24:26] == b"\x10\x00"
            return PNG_DEPTH if is_depth and "32fc1" not in form else form
        return ""

    def _find_calibration(self, options: ImportOptions) -> tuple[StereoCalibration, list[str]]:
        with_color = self._color_topic is not None
        if options.intrinsics is not None:
            file = read_intrinsics(options.intrinsics)
            return file.calibration(with_color=with_color), file.notes
        depth = self._find_intrinsics(self._depth_topic)
        if self._color_topic is None:
            return StereoCalibration(depth, None, np.eye(4), "camera_info"), []
        pose = self._find_pose(self._depth_topic, self._color_topic)
        color = self._find_intrinsics(self._color_topic)
        return StereoCalibration(depth, color, pose, "camera_info"), []

    def _find_unit(self, options: ImportOptions) -> DepthUnit | None:
        topic = self._depth_topic
        self._first(topic)
        encoding = self._encoding_of(topic)
        if topic.kind != COMPRESSED and encoding not in (*images.DEPTH_ENCODINGS, ""):
            raise InvalidRecordingError(
                f"{self._path}: {topic.name} has encoding {encoding!r}, which is no depth; name "
                "another topic with --depth-topic"
            )
        if options.depth_unit_m is not None:
            return DepthUnit(options.depth_unit_m, "given by --depth-unit-m")
        unit_m = realsense.depth_unit_m(self._walk.heard, topic)
        if unit_m is not None and unit_m > 0:
            for name in self._walk.changed.keys() & self._walk.heard.keys():
                raise InvalidRecordingError(
                    f"{self._path}: {name} changes during the recording "
                    f"({self._walk.changed[name]}); give --depth-unit-m for all, or cut it there"
                )
            return DepthUnit(unit_m, "the sensor's option Depth Units in the recording")
        if encoding.startswith("32fc1"):
            return DepthUnit(1.0, "encoding 32FC1: meters (REP 118)")
        if encoding.startswith(("16uc1", PNG_DEPTH)) and not realsense.is_stream(topic):
            return DepthUnit(1e-3, "encoding 16UC1: millimeters (REP 118)")
        return None

    def _find_intrinsics(self, image: Topic) -> Intrinsics:
        topic = info_topic(self._walk.topics, image)
        if topic is None or topic.name not in self._walk.infos:
            known = ", ".join(sorted(self._walk.infos)) or "none"
            raise InvalidRecordingError(
                f"{self._path}: no camera_info belongs to {image.name} (there: {known}); give "
                "--intrinsics FILE"
            )
        if topic.name in self._walk.changed:
            raise InvalidRecordingError(
                f"{self._path}: {topic.name} changes during the recording "
                f"({self._walk.changed[topic.name]}); a recording has one lens: cut the bag there, "
                "or give --intrinsics FILE for all pictures"
            )
        last = base_name(image.name).rpartition("/")[2]
        rectified = "rect" in last and "/device_" not in image.name
        return intrinsics_of(topic.name, self._walk.infos[topic.name], rectified=rectified)

    def _find_pose(self, depth: Topic, color: Topic) -> Float[np.ndarray, "4 4"]:
        try:
            pose = realsense.color_from_depth(self._walk.heard, depth, color)
        except TruncatedError as error:
            raise InvalidRecordingError(
                f"{self._path}: {error}; give the pose with --intrinsics FILE"
            ) from error
        if pose is not None:
            return pose
        here, there = self._frame(depth), self._frame(color)
        if here == there and not realsense.is_stream(depth):
            return np.eye(4)
        if here and there and self._walk.tree.connects(there, here):
            _, frame = self._first(depth)
            return self._walk.tree.lookup(there, here, np.array([frame.time_ns]))[0]
        raise InvalidRecordingError(
            f"{self._path}: depth is in frame {here!r} and color in frame {there!r}, and no TF "
            "ties them; give the pose with --intrinsics FILE"
        )

    def _frame(self, topic: Topic) -> str:
        container, frame = self._first(topic)
        return frame_of(container, topic, frame.place)

    def _find_streams(self, words: str, options: ImportOptions) -> Streams:
        color = self._color_topic
        unit = self._find_unit(options)
        calibration, notes = self._find_calibration(options)
        origins = {"depth": self._depth_topic.name}
        if color is not None:
            self._first(color)
            origins["color"] = color.name
        camera_frame = self._frame(color or self._depth_topic)
        notes += self._movement(camera_frame, options)
        notes += unused(options, "has time stamps", "fps")
        world = None
        if options.world_frame is not None:
            world = self._world_from_camera(camera_frame, options.world_frame)
        picker = bag_paths(self._path, self._walk, options, camera_frame)
        used = [*origins.values(), options.picker_topic or "", options.gripper_topic or ""]
        rest = [topic for topic in self._walk.topics
                if not (options.without_color and topic.name in self._walk.frames)]  # fmt: skip
        recorder = " of the RealSense SDK" if realsense.is_stream(self._depth_topic) else ""
        return Streams(
            kind=words + recorder,
            calibration=calibration,
            unit=unit,
            ask_unit=(
                f"{self._depth_topic.name} has encoding {self._encoding_of(self._depth_topic)!r} "
                "and nothing says how long a unit is; give --depth-unit-m (0.001 for millimeters)"
            ),
            depth=self._walk.frames[self._depth_topic.name],
            color=None if color is None else self._walk.frames[color.name],
            origins={**origins, **picker.origins},
            notes=[*notes, *picker.notes, *left_out(rest, used)],
            marks=self._walk.marks if picker.paths else {},
            paths=picker.paths,
            path_frame=picker.frame,
            path_start_ns=picker.start_ns,
            world_from_camera=world,
        )

    def _movement(self, camera: str, options: ImportOptions) -> list[str]:
        """Return a remark where the camera moves in TF; refuse it in a world that was asked for."""
        tree: Any = self._walk.tree
        world = options.world_frame or (tree.root(camera) if camera else "")
        if not camera or world.lstrip("/") == camera or not tree.connects(world, camera):
            return []
        times = np.array([frame.time_ns for frame in self._walk.frames[self._depth_topic.name]])
        poses = tree.lookup(world, camera, times)
        moved_m = np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1)
        cosine = (np.einsum("nij,ij->n", poses[:, :3, :3], poses[0, :3, :3]) - 1) / 2
        turned = np.arccos(np.clip(cosine, -1, 1))
        if moved_m.max() <= _MOST_MOVED_M and turned.max() <= _MOST_TURNED:
            return []
        words = (
            f"the camera {camera!r} moves by up to {moved_m.max():.3f} m and "
            f"{np.degrees(turned.max()):.1f} degrees against {world!r}"
        )
        if options.world_frame is None:
            return [f"{words}; a recording has one fixed camera: check that it stood still"]
        raise InvalidConfigError(
            f"{self._path}: {words}; a recording has one fixed camera: leave --world-frame out "
            "if it stood still over the table, or cut the bag where it moves"
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


def _decode_depth(topic: Topic, data: bytes) -> Content:
    message = decode(topic, data)
    if topic.kind == COMPRESSED:
        png, curve = images.depth_png(message)
        return packed_depth(png) if curve is None else images.inverse_depth(png, curve)
    return images.raw_depth(message)


def _decode_color(topic: Topic, data: bytes) -> Content:
    message = decode(topic, data)
    if topic.kind == COMPRESSED:
        return packed_color(bytes(message.data))
    return images.raw_color(message)
