"""A process of its own that speaks ROS 2 over DDS, and knows nothing of clothtrack.

Its message types are written down here by hand, and `cyclonedds` writes and reads their bytes: what
it understands, another program understands.

    python dds_player.py RECORDING OUT.npz DEPTH_ENCODING COLOR_ENCODING PACED BURST

It plays the first PACED frames, each when the mesh of the one before has come, then BURST frames at
once. OUT has what it received.
"""

import csv
import json
import os
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

START_NS = 1_700_000_000_123_456_789
PATIENCE = duration(seconds=20)


def message(package, name, /, **fields):
    """A message type: a class whose fields are given in order."""
    return make_idl_struct(name, f"{package}::msg::dds_::{name}_", fields)


Time = message("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Duration = message("builtin_interfaces", "Duration", sec=int32, nanosec=uint32)
Header = message("std_msgs", "Header", stamp=Time, frame_id=str)
Bool = message("std_msgs", "Bool", data=bool)
ColorRGBA = message("std_msgs", "ColorRGBA", r=float32, g=float32, b=float32, a=float32)
Image = message(
    "sensor_msgs", "Image", header=Header, height=uint32, width=uint32, encoding=str,
    is_bigendian=uint8, step=uint32, data=sequence[uint8],
)  # fmt: skip
RegionOfInterest = message(
    "sensor_msgs", "RegionOfInterest", x_offset=uint32, y_offset=uint32, height=uint32,
    width=uint32, do_rectify=bool,
)  # fmt: skip
CameraInfo = message(
    "sensor_msgs", "CameraInfo", header=Header, height=uint32, width=uint32, distortion_model=str,
    d=sequence[float64], k=array[float64, 9], r=array[float64, 9], p=array[float64, 12],
    binning_x=uint32, binning_y=uint32, roi=RegionOfInterest,
)  # fmt: skip
Point = message("geometry_msgs", "Point", x=float64, y=float64, z=float64)
Vector3 = message("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
Quaternion = message("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = message("geometry_msgs", "Pose", position=Point, orientation=Quaternion)
PoseStamped = message("geometry_msgs", "PoseStamped", header=Header, pose=Pose)
CompressedImage = message(
    "sensor_msgs", "CompressedImage", header=Header, format=str, data=sequence[uint8]
)
UVCoordinate = message("visualization_msgs", "UVCoordinate", u=float32, v=float32)
MeshFile = message("visualization_msgs", "MeshFile", filename=str, data=sequence[uint8])
Marker = message(
    "visualization_msgs", "Marker", header=Header, ns=str, id=int32, type=int32, action=int32,
    pose=Pose, scale=Vector3, color=ColorRGBA, lifetime=Duration, frame_locked=bool,
    points=sequence[Point], colors=sequence[ColorRGBA], texture_resource=str,
    texture=CompressedImage, uv_coordinates=sequence[UVCoordinate], text=str, mesh_resource=str,
    mesh_file=MeshFile, mesh_use_embedded_materials=bool,
)  # fmt: skip
PointField = message(
    "sensor_msgs", "PointField", name=str, offset=uint32, datatype=uint8, count=uint32
)
PointCloud2 = message(
    "sensor_msgs", "PointCloud2", header=Header, height=uint32, width=uint32,
    fields=sequence[PointField], is_bigendian=bool, point_step=uint32, row_step=uint32,
    data=sequence[uint8], is_dense=bool,
)  # fmt: skip


class Player:
    """Publishes a recording, and gathers meshes."""

    def __init__(self, recording, depth_encoding, color_encoding):
        self.folder = recording
        self.document = json.loads((recording / "recording.json").read_text())
        with (recording / "picker.csv").open() as file:
            self.picker = list(csv.DictReader(file))
        self.depth_encoding, self.color_encoding = depth_encoding, color_encoding
        self.participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        best = Policy.Reliability.BestEffort
        sure = Policy.Reliability.Reliable(duration(seconds=1))
        self.writers = {
            name: self.writer(f"rt/{name}", kind, quality)
            for name, kind, quality in (
                ("camera/camera_info", CameraInfo, best),
                ("camera/color", Image, best),
                ("camera/depth", Image, sure),
                ("arm/tip", PoseStamped, best),
                ("arm/closed", Bool, sure),
            )
        }
        self.mesh = self.reader("rt/clothtrack/mesh", Marker)
        self.cloud = self.reader("rt/clothtrack/vertices", PointCloud2)
        self.got = {}

    def writer(self, name, kind, quality):
        qos = Qos(quality, Policy.History.KeepLast(5))
        return DataWriter(self.participant, Topic(self.participant, name, kind), qos=qos)

    def reader(self, name, kind):
        qos = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(10))
        return DataReader(self.participant, Topic(self.participant, name, kind), qos=qos)

    def wait_for_the_other_side(self):
        end = time.monotonic() + 20
        while not (
            all(one.get_matched_subscriptions() for one in self.writers.values())
            and all(one.get_matched_publications() for one in (self.mesh, self.cloud))
        ):
            assert time.monotonic() < end, "nobody listens"
            time.sleep(0.01)

    def play(self, index):
        frame = self.document["frames"][index]
        stamp_ns = START_NS + round(frame["time_s"] * 1e9)
        head = Header(Time(stamp_ns // 10**9, stamp_ns % 10**9), "camera_optical_frame")
        row = self.picker[index]
        assert float(row["time_s"]) == frame["time_s"]
        tip = Point(*(float(row[f"{axis}_m"]) for axis in "xyz"))
        world = Header(head.stamp, "world")
        self.send("camera/camera_info", self.intrinsics(head))
        self.send("arm/closed", Bool(row["closed"] == "1"))
        self.send("arm/tip", PoseStamped(world, Pose(tip, Quaternion(0.0, 0.0, 0.0, 1.0))))
        bgr = cv2.imread(str(self.folder / frame["color"]))
        color = bgr if self.color_encoding == "bgr8" else bgr[..., ::-1]
        self.send("camera/color", image(head, color, self.color_encoding))
        counts = cv2.imread(str(self.folder / frame["depth"]), cv2.IMREAD_UNCHANGED)
        if self.depth_encoding == "32FC1":
            counts = counts.astype(np.float32) * np.float32(0.001)
            counts[counts == 0] = np.nan
        self.send("camera/depth", image(head, counts, self.depth_encoding))
        return stamp_ns

    def send(self, name, message):
        self.writers[name].write(message)

    def intrinsics(self, head):
        camera = self.document["cameras"][0]
        fx, fy, cx, cy = (camera[name] for name in ("fx", "fy", "cx", "cy"))
        return CameraInfo(
            head, camera["height"], camera["width"], "plumb_bob", [0.0] * 5,
            [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], list(np.eye(3).ravel()),
            [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0], 0, 0,
            RegionOfInterest(0, 0, 0, 0, False),
        )  # fmt: skip

    def receive(self, stamp_ns):
        mesh, cloud = self.mesh.take_one(timeout=PATIENCE), self.cloud.take_one(timeout=PATIENCE)
        stamps = [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in (mesh, cloud)]
        assert stamps == [stamp_ns, stamp_ns]
        assert mesh.type == 11
        assert [field.name for field in cloud.fields] == [
            "x", "y", "z", "expected_error_m", "visible",
        ]  # fmt: skip
        rows = np.frombuffer(bytes(cloud.data), np.uint8).reshape(cloud.width, cloud.point_step)
        values = np.ascontiguousarray(rows[:, :16]).view("<f4")
        for name, value in {
            "stamps": stamp_ns,
            "corners": [[one.x, one.y, one.z] for one in mesh.points],
            "colors": [[one.r, one.g, one.b, one.a] for one in mesh.colors],
            "vertices": values[:, :3],
            "errors": values[:, 3],
            "visible": rows[:, cloud.fields[4].offset],
            "frames": [mesh.header.frame_id, cloud.header.frame_id],
        }.items():
            self.got.setdefault(name, []).append(value)


def image(head, picture, encoding):
    rows = np.ascontiguousarray(picture)
    height, width = rows.shape[:2]
    return Image(head, height, width, encoding, 0, rows.strides[0], rows.tobytes())


def main(arguments):
    recording, out, *encodings, paced, burst = arguments
    player = Player(Path(recording), *encodings)
    player.wait_for_the_other_side()
    for index in range(int(paced)):
        player.receive(player.play(index))
    for index in range(int(paced), int(paced) + int(burst)):
        stamp_ns = player.play(index)
    sys.stdout.write("all sent\n")
    sys.stdout.flush()
    player.receive(stamp_ns)
    np.savez(out, **{name: np.array(value) for name, value in player.got.items()})


if __name__ == "__main__":
    main(sys.argv[1:])
