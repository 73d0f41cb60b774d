"""Recordings in every format that is imported, written by the formats' own libraries.

The pictures are random, so that a wrong row, a swapped byte or a lost bit shows.
"""

import json
import sqlite3
import struct
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333
OPTICAL = "camera_color_optical_frame"


@dataclass
class Film:
    """What a camera saw: depth [units], color, times [ns], one lens."""

    frames: int = 4
    width: int = 32
    height: int = 24
    seed: int = 0
    f: float = 30.0
    depth: np.ndarray = field(init=False)
    color: np.ndarray = field(init=False)
    times: np.ndarray = field(init=False)

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        shape = (self.frames, self.height, self.width)
        self.depth = rng.integers(400, 1500, shape).astype(np.uint16)
        self.depth[rng.random(shape) < 0.1] = 0
        self.color = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
        self.times = START_NS + PERIOD_NS * np.arange(self.frames, dtype=np.int64)

    @property
    def matrix(self):
        return np.array(
            [self.f, 0, self.width / 2 - 0.5, 0, self.f, self.height / 2 - 0.5, 0, 0, 1]
        )


class Messages:
    """Builds and serializes messages for ROS 1 or ROS 2."""

    def __init__(self, *, cdr):
        self.cdr = cdr
        self.store = get_typestore(Stores.ROS2_HUMBLE if cdr else Stores.ROS1_NOETIC)
        if not cdr:
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))

    def make(self, kind, **fields):
        return self.store.types[kind](**fields)

    def pack(self, message):
        pack = self.store.serialize_cdr if self.cdr else self.store.serialize_ros1
        return pack(message, message.__msgtype__)

    def header(self, time_ns, frame=OPTICAL):
        stamp = self.make(
            "builtin_interfaces/msg/Time",
            sec=int(time_ns) // 10**9,
            nanosec=int(time_ns) % 10**9,
        )
        extra = {} if self.cdr else {"seq": 0}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **extra)

    def image(self, time_ns, picture, encoding, frame=OPTICAL, padding=0):
        height, width = picture.shape[:2]
        rows = np.ascontiguousarray(picture).view(np.uint8).reshape(height, -1)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=7)
        return self.make(
            "sensor_msgs/msg/Image", header=self.header(time_ns, frame), height=height, width=width,
            encoding=encoding, is_bigendian=0, step=rows.shape[1], data=rows.ravel(),
        )  # fmt: skip

    def compressed(self, time_ns, data, form, frame=OPTICAL):
        return self.make(
            "sensor_msgs/msg/CompressedImage", header=self.header(time_ns, frame), format=form,
            data=np.frombuffer(data, np.uint8),
        )  # fmt: skip

    def info(self, time_ns, film, frame=OPTICAL, model="plumb_bob", d=(0.0,) * 5):
        k, d = film.matrix, np.array(d)
        p = np.insert(k, [3, 6, 9], 0.0)
        names = ("d", "k", "r", "p") if self.cdr else ("D", "K", "R", "P")
        values = dict(zip(names, (d, k, np.eye(3).ravel(), p), strict=True))
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
            do_rectify=False,
        )  # fmt: skip
        return self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(time_ns, frame), height=film.height,
            width=film.width, distortion_model=model, binning_x=0, binning_y=0, roi=roi, **values,
        )  # fmt: skip

    def vector(self, values, kind="Vector3"):
        x, y, z = map(float, values)
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def turn(self, values=(0, 0, 0, 1)):
        x, y, z, w = map(float, values)
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def transform(self, translation, rotation=(0, 0, 0, 1)):
        return self.make(
            "geometry_msgs/msg/Transform", translation=self.vector(translation),
            rotation=self.turn(rotation),
        )  # fmt: skip

    def tf(self, time_ns, parent, child, translation, rotation=(0, 0, 0, 1)):
        one = self.make(
            "geometry_msgs/msg/TransformStamped", header=self.header(time_ns, parent),
            child_frame_id=child, transform=self.transform(translation, rotation),
        )  # fmt: skip
        return self.make("tf2_msgs/msg/TFMessage", transforms=[one])

    def pose(self, time_ns, frame, position):
        pose = self.make(
            "geometry_msgs/msg/Pose", position=self.vector(position, "Point"),
            orientation=self.turn(),
        )  # fmt: skip
        header = self.header(time_ns, frame)
        return self.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose)

    def value(self, kind, data):
        return self.make(f"std_msgs/msg/{kind}", data=data)


def stream(film, messages, *, depth="/camera/aligned_depth_to_color/image_raw",
           color="/camera/color/image_raw", log_delay_ns=0, color_delay_ns=0):  # fmt: skip
    """(topic, time of writing, message) of a registered camera, as a ROS driver publishes it."""
    for k, time in enumerate(film.times.tolist()):
        log = time + log_delay_ns
        for topic in (depth, color):
            info = topic.rpartition("/")[0] + "/camera_info"
            yield info, log, messages.info(time, film)
        yield depth, log, messages.image(time, film.depth[k], "16UC1")
        shown = messages.image(time + color_delay_ns, film.color[k], "rgb8")
        yield color, log + color_delay_ns, shown


def write_ros2(path, entries, messages, *, storage="mcap", compression=None):
    """A ROS 2 bag folder by rosbags."""
    plugin = rosbag2.StoragePlugin[storage.upper()]
    writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if compression:
        mode = rosbag2.CompressionMode[compression.upper()]
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    _write(writer, entries, messages)
    return path


def write_ros1(path, entries, messages, *, compression=None):
    """A ROS 1 bag by rosbags."""
    writer = rosbag1.Writer(path)
    if compression:
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    _write(writer, entries, messages)
    return path


def _write(writer, entries, messages):
    with writer:
        known = {}
        for topic, time, message in entries:
            if topic not in known:
                known[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=messages.store
                )
            writer.write(known[topic], int(time), messages.pack(message))


def kinect_calibration():
    """A calibration as the device holds it: shares of the full sensors, meters."""

    def camera(location, lens, rotation, translation, *, width, height):
        return {
            "Intrinsics": {
                "ModelParameterCount": 14,
                "ModelParameters": lens,
                "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
            },
            "Location": location,
            "MetricRadius": 1.7,
            "Rt": {"Rotation": rotation, "Translation": translation},
            "SensorWidth": width,
            "SensorHeight": height,
        }

    tilt = np.radians(6.0)
    tilted = [1, 0, 0, 0, np.cos(tilt), np.sin(tilt), 0, -np.sin(tilt), np.cos(tilt)]
    flat = [1.0, 0, 0, 0, 1, 0, 0, 0, 1]
    depth_lens = [0.5, 0.5, 0.49, 0.49, 0.5, 0.1, 0.005, 0.8, 0.2, 0.02, 0, 0, 1e-4, -5e-5]
    color_lens = [0.5, 0.5, 0.48, 0.64, 0.4, -2.5, 1.5, 0.3, -2.3, 1.4, 0, 0, -2e-4, 4e-4]
    cameras = [
        camera("CALIBRATION_CameraLocationD0", depth_lens, flat, [0.0, 0, 0],
               width=1024, height=1024),
        camera("CALIBRATION_CameraLocationPV0", color_lens, tilted, [-0.032, -0.002, 0.004],
               width=4096, height=3072),
    ]  # fmt: skip
    return {"CalibrationInformation": {"Cameras": cameras}}


def element(kind, content):
    """An EBML element."""
    name = kind.to_bytes((kind.bit_length() + 7) // 8, "big")
    return name + (len(content) | 1 << 56).to_bytes(8, "big") + content


def number(kind, value):
    return element(kind, value.to_bytes(8, "big"))


def write_kinect(path, depth, color, times_ns, *, letters=b"MJPG", calibration=None, packing=b""):
    """A Matroska file as k4arecorder lays it out; no library writes its raw depth track."""

    def track(index, name, width, height, fourcc):
        head = struct.pack("<IiiHH4sIiiII", 40, width, height, 1, 16, fourcc, 0, 0, 0, 0, 0)
        video = number(0xB0, width) + number(0xBA, height)
        return element(0xAE, b"".join([
            number(0xD7, index), number(0x73C5, index), number(0x83, 1),
            element(0x536E, name), element(0x86, b"V_MS/VFW/FOURCC"), element(0x63A2, head),
            element(0xE0, video), packing,
        ]))  # fmt: skip

    height, width = depth.shape[1:]
    tracks = track(2, b"DEPTH", width, height, b"b16g")
    if color is not None:
        tracks = track(1, b"COLOR", *color.shape[2:0:-1], letters) + tracks
    tag = element(0x63C0, number(0x63C5, 2)) + element(
        0x67C8, element(0x45A3, b"K4A_DEPTH_MODE") + element(0x4487, b"NFOV_2X2BINNED")
    )
    text = json.dumps(kinect_calibration() if calibration is None else calibration).encode()
    attached = element(0x466E, b"calibration.json") + element(0x4660, b"application/octet-stream")
    attached += number(0x46AE, 77) + element(0x465C, text)
    clusters = b""
    for k, time in enumerate(times_ns[: len(depth)]):
        blocks = number(0xE7, int(time) // 1000)
        if color is not None:
            blocks += element(0xA3, b"\x81\x00\x00\x80" + _kinect_color(color[k], letters))
        raw = depth[k].astype(">u2").tobytes()
        blocks += element(0xA0, element(0xA1, b"\x82\x00\x00\x80" + raw))
        clusters += element(0x1F43B675, blocks)
    body = element(0x1549A966, number(0x2AD7B1, 1000) + element(0x4D80, b"k4a"))
    body += element(0x1654AE6B, tracks) + element(0x1254C367, element(0x7373, tag))
    body += element(0x1941A469, element(0x61A7, attached)) + clusters
    head = number(0x4286, 1) + number(0x42F7, 1) + number(0x42F2, 4) + number(0x42F3, 8)
    head += element(0x4282, b"matroska") + number(0x4287, 2) + number(0x4285, 2)
    path.write_bytes(element(0x1A45DFA3, head) + element(0x18538067, body))
    return path


def _kinect_color(picture, letters):
    if letters == b"MJPG":
        return cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[
            1
        ].tobytes()
    return cv2.cvtColor(picture, cv2.COLOR_RGB2BGRA).tobytes()


def png(picture):
    ordered = picture[..., ::-1] if picture.ndim == 3 else picture
    return cv2.imencode(".png", np.ascontiguousarray(ordered))[1].tobytes()


def write_folder(path, film, style):
    """A folder of pictures in the style of "tum", "open3d" or "bop"."""
    color_name = "color" if style == "open3d" else "rgb"
    for name in ("depth", color_name):
        (path / name).mkdir(parents=True)
    k = film.matrix.tolist()
    lists = {"depth": ["# depth maps"], "rgb": ["# color images"]}
    for number_, time in enumerate(film.times.tolist()):
        stem = f"{time / 1e9:.6f}" if style == "tum" else f"{number_:06d}"
        (path / "depth" / f"{stem}.png").write_bytes(png(film.depth[number_]))
        (path / color_name / f"{stem}.png").write_bytes(png(film.color[number_]))
        lists["depth"].append(f"{time // 10**9}.{time % 10**9:09d} depth/{stem}.png")
        lists["rgb"].append(f"{time // 10**9}.{time % 10**9:09d} rgb/{stem}.png")
    if style == "tum":
        for name, lines in lists.items():
            (path / f"{name}.txt").write_text("\n".join(lines) + "\n")
    elif style == "open3d":
        columns = [k[0], 0, 0, 0, k[4], 0, k[2], k[5], 1]
        content = {"width": film.width, "height": film.height, "intrinsic_matrix": columns,
                   "fps": 30, "depth_scale": 1000.0}  # fmt: skip
        (path / "intrinsic.json").write_text(json.dumps(content))
    else:
        content = {str(n): {"cam_K": k, "depth_scale": 0.1} for n in range(film.frames)}
        (path / "scene_camera.json").write_text(json.dumps(content))
    return path


def lens_file(path, film, **more):
    """The film's lens as an intrinsics file."""
    k = film.matrix.tolist()
    lens = {
        "width": film.width,
        "height": film.height,
        "fx": k[0],
        "fy": k[4],
        "cx": k[2],
        "cy": k[5],
    }
    path.write_text(json.dumps(lens | more))
    return path


def write_realsense_db3(path, film, shift_m=0.0):
    """A `.db3` as the RealSense SDK 2.59 writes it: strings around compressed pictures."""
    messages = Messages(cdr=True)
    base = sqlite3.connect(path)
    base.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,"
        "serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,"
        "timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    )
    known = {}

    def put(topic, time, message):
        if topic not in known:
            known[topic] = len(known) + 1
            base.execute(
                "INSERT INTO topics VALUES(?,?,?,'cdr','')",
                (known[topic], topic, message.__msgtype__),
            )
        data = bytes(messages.pack(message))
        base.execute("INSERT INTO messages(topic_id,timestamp,data) VALUES(?,?,?)",
                     (known[topic], time, data))  # fmt: skip

    depth, color = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"
    put("/device_0/sensor_0/option/Depth_Units/value", 0, messages.value("String", "0.000250"))
    for stream_, shift in ((depth, 0.0), (color, shift_m)):
        turn = "1.0,0.0,0.0,0.0,1.0,0.0,0.0,0.0,1.0"
        pose = f"rotation={turn};translation={shift:.6f},0.0,0.0"
        put(f"{stream_}/tf/ref_1", 0, messages.value("String", pose))
        # As the SDK writes it: other axes, another direction. It must not be used.
        put("/tf_static", 0, messages.tf(0, "ref_1", stream_[-7:-2], (0, -shift, 0.5)))
    for k in range(film.frames):
        time = 1000 + k * PERIOD_NS
        head = struct.pack("<Iff", 0, 0.0, 0.0)
        packed = head + png(film.depth[k])
        put(f"{depth}/image/data/compressedDepth", time,
            messages.compressed(time, packed, "16UC1; compressedDepth png", "Depth"))  # fmt: skip
        put(f"{depth}/image/camera_info", time, messages.info(time, film, "Depth"))
        put(f"{color}/image/data/compressed", time,
            messages.compressed(time, png(film.color[k]), "rgb8; png compressed bgr8",
                                "Color"))  # fmt: skip
        put(f"{color}/image/camera_info", time, messages.info(time, film, "Color"))
    base.commit()
    base.close()
    return path


def write_realsense_bag(path, film, *, units=0.00025):
    """A ROS 1 bag as the old RealSense SDK wrote it: typed messages, encoding mono16."""
    messages = Messages(cdr=False)
    depth, color = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"
    entries = []
    if units is not None:
        option = "/device_0/sensor_0/option/Depth Units/value"
        entries.append((option, 1, messages.value("Float32", units)))
    for one in (depth, color):
        entries.append((f"{one}/info/camera_info", 1, messages.info(0, film, "", "Brown Conrady")))
        entries.append((f"{one}/tf/0", 1, messages.transform((0, 0, 0))))
    for k in range(film.frames):
        time = 360_000_000_000 + k * PERIOD_NS
        entries.append(
            (f"{depth}/image/data", 1 + k, messages.image(time, film.depth[k], "mono16", "0"))
        )
        entries.append(
            (f"{color}/image/data", 1 + k, messages.image(time, film.color[k], "rgb8", "0"))
        )
    return write_ros1(path, entries, messages)


def depth_of(recording):
    """The counts of every frame of a recording, as written."""
    files = sorted((Path(recording) / "depth").glob("*.png"))
    return np.stack([cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files])


def color_of(recording):
    """The colors of every frame of a recording."""
    files = sorted((Path(recording) / "color").glob("*.png"))
    return np.stack([cv2.imread(str(file))[..., ::-1] for file in files])
