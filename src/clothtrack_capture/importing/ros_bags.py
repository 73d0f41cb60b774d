"""ROS 1, ROS 2 and RealSense bags as a source: topics, intrinsics and depth unit.

Old recordings of the RealSense SDK (`.bag`) have typed messages, and new ones (`.db3`) have strings
`key=value;...`. `/tf_static` of the new ones uses another convention (x forward) and is ignored.
"""

import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from clothtrack.errors import InvalidConfigError, InvalidRecordingError, TruncatedError
from clothtrack_capture.importing import images
from clothtrack_capture.importing.bag_pickers import bag_paths
from clothtrack_capture.importing.bag_walk import in_time_order, walk
from clothtrack_capture.importing.containers import Container, Topic, open_part
from clothtrack_capture.importing.images import packed_color
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
    SDK_STREAM,
    base_name,
    choose_color,
    choose_depth,
    info_topic,
    left_out,
)
from clothtrack_capture.importing.transforms import rigid
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
        self._path, self._parts = path, list[Container]()
        try:
            for file in bag_files(path):
                self._parts.append(open_part(file))
            self._parts = in_time_order(self._parts)
            self._walk = walk(path, self._parts, options)
            topics, encoding = self._walk.topics, self._encoding_of
            if not topics:
                raise InvalidRecordingError(f"{path}: no topic at all; record or copy it again")
            depth = self._depth = choose_depth(path, topics, options.depth_topic, encoding)
            self._color = None
            if not options.without_color:
                self._color = choose_color(path, topics, depth, options.color_topic, encoding)
            self.streams = self._find_streams(options)
        except BaseException:
            self.close()
            raise

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture."""
        topic = self._depth if kind == "depth" else self._color
        assert topic is not None
        return partial(_decode, topic, self._read(frame), is_depth=kind == "depth")

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()

    def _read(self, frame: StreamFrame) -> bytes:
        return payload(self._parts[frame.place.part], frame.place)

    def _first(self, topic: Topic) -> StreamFrame:
        frames = self._walk.frames.get(topic.name)
        if not frames:
            raise InvalidRecordingError(
                f"{self._path}: not one picture of {topic.name}; record it again, or "
                "name another topic with --depth-topic or --color-topic"
            )
        return frames[0]

    def _encoding_of(self, topic: Topic) -> str:
        """Return the encoding of a topic's pictures, from the first readable one; "" if none is."""
        for frame in self._walk.frames.get(topic.name, ()):
            try:
                message = decode(topic, self._read(frame))
            except TruncatedError:
                continue
            if topic.kind != COMPRESSED:
                return str(message.encoding).lower()
            form, start = str(message.format).lower(), bytes(message.data[:32])
            is_depth = start.startswith(images.SIGNATURE) and start[24:26] == b"\x10\x00"
            return PNG_DEPTH if is_depth and "32fc1" not in form else form
        return ""

    def _find_calibration(self, options: ImportOptions) -> tuple[StereoCalibration, list[str]]:
        if options.intrinsics is not None:
            file = read_intrinsics(options.intrinsics)
            return file.calibration(with_color=self._color is not None), file.notes
        depth, color, pose = self._find_intrinsics(self._depth), None, np.eye(4)
        if self._color is not None:
            pose = self._find_pose(self._depth, self._color)
            color = self._find_intrinsics(self._color)
        return StereoCalibration(depth, color, pose, "camera_info"), []

    def _find_unit(self, options: ImportOptions) -> DepthUnit | None:
        topic = self._depth
        self._first(topic)
        encoding = self._encoding_of(topic)
        if topic.kind != COMPRESSED and encoding not in (*images.DEPTH_ENCODINGS, ""):
            raise InvalidRecordingError(
                f"{self._path}: {topic.name} has encoding {encoding!r}, which is no depth; name "
                "another topic with --depth-topic"
            )
        if options.depth_unit_m is not None:
            return DepthUnit(options.depth_unit_m, "given by --depth-unit-m")
        unit_m = self._option_unit_m(topic)
        if unit_m > 0:
            for name in self._walk.changed.keys() & self._walk.heard.keys():
                raise InvalidRecordingError(
                    f"{self._path}: {name} changes during the recording "
                    f"({self._walk.changed[name]}); give --depth-unit-m for all, or cut it there"
                )
            return DepthUnit(unit_m, "the sensor's option Depth Units in the recording")
        if encoding.startswith("32fc1"):
            return DepthUnit(1.0, "encoding 32FC1: meters (REP 118)")
        if encoding.startswith(("16uc1", PNG_DEPTH)) and not _of_the_sdk(topic):
            return DepthUnit(1e-3, "encoding 16UC1: millimeters (REP 118)")
        return None

    def _option_unit_m(self, depth: Topic) -> float:
        """Return meters per unit of depth, from the option of a RealSense sensor; 0 if unknown."""
        sensor = SDK_STREAM.sub(r"\1", base_name(depth.name))
        for spelling in ("Depth Units", "Depth_Units"):
            with suppress(KeyError, ValueError):
                message = self._walk.heard[f"{sensor}/option/{spelling}/value"]
                # The SDK stores a 32-bit float, so 0.001 is read as 0.0010000000474974513.
                return float(f"{float(message.data):.6g}")
        return 0.0

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
        """Return the transform from depth to color camera [m]."""
        poses: list[dict[str, np.ndarray]] = []
        for topic in (depth, color):
            head = f"{base_name(topic.name).removesuffix('/image/data')}/tf/"
            poses.append({name.removeprefix(head): self._sdk_pose(message)
                          for name, message in self._walk.heard.items()
                          if name.startswith(head)})  # fmt: skip
        if shared := sorted(poses[0].keys() & poses[1].keys()):
            return poses[1][shared[0]] @ np.linalg.inv(poses[0][shared[0]])
        here, there = self._frame(depth), self._frame(color)
        if here == there and not _of_the_sdk(depth):
            return np.eye(4)
        if here and there and self._walk.tree.connects(there, here):
            return self._walk.tree.lookup(there, here, np.array([self._first(depth).time_ns]))[0]
        raise InvalidRecordingError(
            f"{self._path}: depth is in frame {here!r} and color in frame {there!r}, and no TF "
            "ties them; give the pose with --intrinsics FILE"
        )

    def _sdk_pose(self, message: Any) -> Float[np.ndarray, "4 4"]:
        """Return the transform from the reference stream to the one that a message is about."""
        try:
            if hasattr(message, "rotation"):
                q, t = message.rotation, message.translation
                return rigid(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])
            fields = dict(part.split("=", 1) for part in message.data.split(";") if "=" in part)
            rotation, translation = (np.array(fields[name].split(","), dtype=np.float64)
                                     for name in ("rotation", "translation"))  # fmt: skip
            return rigid(rotation.reshape(3, 3).T, translation)  # The SDK writes column by column.
        except (AttributeError, KeyError, ValueError, TruncatedError) as error:
            raise InvalidRecordingError(
                f"{self._path}: a stream's pose cannot be read ({error}); give it with "
                "--intrinsics FILE"
            ) from error

    def _frame(self, topic: Topic) -> str:
        """Return the frame in the header of a topic's first picture; "" if it has none."""
        frame = self._first(topic)
        with suppress(TruncatedError):
            data = self._read(frame)[:512]
            order = "little" if not topic.cdr or data[1:2] == b"\x01" else "big"
            length = int.from_bytes(data[12:16], order)
            if 0 < length <= 256:
                return data[16 : 16 + length].split(b"\0")[0].decode("utf-8", "replace").lstrip("/")
        return ""

    def _find_streams(self, options: ImportOptions) -> Streams:
        depth, color, frames = self._depth, self._color, self._walk.frames
        unit = self._find_unit(options)
        calibration, notes = self._find_calibration(options)
        origins = {"depth": depth.name}
        if color is not None:
            self._first(color)
            origins["color"] = color.name
        camera = self._frame(color or depth)
        world, remarks = self._world_from_camera(camera, options)
        notes += remarks + unused(options, "has time stamps", "fps")
        picker = bag_paths(self._path, self._walk, options, camera)
        used = [*origins.values(), options.picker_topic or "", options.gripper_topic or ""]
        rest = [topic for topic in self._walk.topics
                if not (options.without_color and topic.name in frames)]  # fmt: skip
        recorder = " of the RealSense SDK" if _of_the_sdk(depth) else ""
        return Streams(
            kind=self._parts[-1].words + recorder,
            calibration=calibration,
            unit=unit,
            ask_unit=(
                f"{depth.name} has encoding {self._encoding_of(depth)!r} and nothing says how long "
                "a unit is; give --depth-unit-m (0.001 for millimeters)"
            ),
            depth=frames[depth.name],
            color=None if color is None else frames[color.name],
            origins={**origins, **picker.origins},
            notes=[*notes, *picker.notes, *left_out(rest, used)],
            marks=self._walk.marks if picker.paths else {},
            paths=picker.paths,
            path_frame=picker.frame,
            path_start_ns=picker.start_ns,
            world_from_camera=world,
        )

    def _world_from_camera(
        self, camera: str, options: ImportOptions
    ) -> tuple[Float[np.ndarray, "4 4"] | None, list[str]]:
        """Return the pose in the world that was asked for, and a remark if the camera moves."""
        tree, asked = self._walk.tree, options.world_frame
        world = tree.root(camera) if asked is None else asked
        if not camera or not tree.connects(world, camera):
            if asked is None:
                return None, []
            raise InvalidConfigError(
                f"{self._path}: no TF ties the camera's frame {camera!r} to --world-frame "
                f"{world!r}; frames: {', '.join(tree.frames) or 'none'}"
            )
        times = [frame.time_ns for frame in self._walk.frames[self._depth.name]]
        poses = tree.lookup(world, camera, np.array(times))
        moved_m = np.linalg.norm(poses[:, :3, 3] - poses[0, :3, 3], axis=1).max()
        cosine = (np.einsum("nij,ij->n", poses[:, :3, :3], poses[0, :3, :3]) - 1) / 2
        turned = np.arccos(np.clip(cosine, -1, 1)).max()
        words = (
            f"the camera {camera!r} moves by up to {moved_m:.3f} m and {np.degrees(turned):.1f} "
            f"degrees against {world!r}; a recording has one fixed camera: "
        )
        moves = moved_m > _MOST_MOVED_M or turned > _MOST_TURNED
        if asked is None:
            return None, [f"{words}check that it stood still"] if moves else []
        if moves:
            raise InvalidConfigError(
                f"{self._path}: {words}leave --world-frame out if it stood still over the table, "
                "or cut the bag where it moves"
            )
        first = self._first(self._color or self._depth)
        return tree.lookup(world, camera, np.array([first.time_ns]))[0], []


def _of_the_sdk(topic: Topic) -> bool:
    return bool(SDK_STREAM.match(base_name(topic.name)))


def _decode(topic: Topic, data: bytes, *, is_depth: bool) -> Content:
    message = decode(topic, data)
    if topic.kind != COMPRESSED:
        return images.raw_depth(message) if is_depth else images.raw_color(message)
    return images.compressed_depth(message) if is_depth else packed_color(bytes(message.data))
