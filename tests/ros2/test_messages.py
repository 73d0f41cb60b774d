"""Bytes of ROS 2 messages: as `rosbags` and `cyclonedds` write them, each on its own."""

import struct

import numpy as np
import pytest
from import_makers import Film, Messages

pytest.importorskip("cyclonedds", reason="the extra [ros2] brings it")

from clothtrack_capture.ros2.mesh_messages import (
    MARKER,
    POINT_CLOUD,
    TriangleMarker,
    vertex_cloud,
)
from clothtrack_capture.ros2.message_types import dds_name, dds_type, idl_struct, ros_name

MESSAGES = Messages(cdr=True)
FRAMES = "world", "a frame of some name"


def some(rng, kind):
    """A message of a type with drawn content."""
    store = MESSAGES.store
    node, content = kind
    if node.name == "NAME":
        fields = store.fielddefs[content][1]
        return store.types[content](**{name: some(rng, one) for name, one in fields})
    if node.name == "BASE":
        return drawn(rng, content[0])
    element, length = content
    count = length if node.name == "ARRAY" else int(rng.integers(0, 4))
    values = [some(rng, element) for _ in range(count)]
    numbers = element[0].name == "BASE" and element[1][0] not in ("string", "bool")
    return np.array(values, element[1][0]) if numbers else values


def drawn(rng, base):
    if base == "string":
        return "".join(rng.choice(list("abc_é"), rng.integers(0, 7)))
    if base == "bool":
        return bool(rng.integers(2))
    if base.startswith("float"):
        return float(np.float32(rng.normal()))
    return int(rng.integers(0, 100))


def plain(kind, message):
    """The same message as `cyclonedds` takes it: its own classes, and lists."""
    if hasattr(message, "__msgtype__"):
        fields = [name for name, _ in MESSAGES.store.fielddefs[message.__msgtype__][1]]
        content = {name: plain(None, getattr(message, name)) for name in fields}
        return idl_struct(message.__msgtype__)(**content)
    if isinstance(message, np.ndarray | list):
        return [plain(None, one) for one in message]
    return message.item() if isinstance(message, np.generic) else message


@pytest.mark.parametrize(
    "kind",
    [
        "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/PointCloud2", "std_msgs/msg/Bool", "std_msgs/msg/Float32",
        "std_msgs/msg/Float64", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/TransformStamped",
        "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/Marker",
    ],
)  # fmt: skip
def test_the_layout_that_dds_is_told_is_that_of_the_bytes(kind, rng):
    from rosbags.typesys.base import Nodetype

    assert ros_name(dds_name(kind)) == kind
    for _ in range(5):
        message = some(rng, (Nodetype.NAME, kind))
        written = bytes(MESSAGES.pack(message))
        own = plain(None, message).serialize(use_version_2=False)
        # One pads the end to a whole number of four bytes, the other does not.
        assert written.ljust(len(own), b"\0") == own.ljust(len(written), b"\0")
        assert dds_type(kind).deserialize(written).serialize() == written


def test_a_marker_is_written_as_its_definition_says(rng):
    kinds = MESSAGES.store.types
    for frame_id, corners in zip(FRAMES, (3, 30), strict=True):
        places, colors = rng.normal(size=(corners, 3)), rng.random((corners, 4)).astype(np.float32)
        stamp_ns = 1_700_000_000_987_654_321
        data = TriangleMarker(frame_id).encode(stamp_ns, places, colors.astype(float))
        marker = MESSAGES.store.deserialize_cdr(data, MARKER)
        assert marker.type == kinds[MARKER].TRIANGLE_LIST
        assert marker.header.frame_id == frame_id
        assert (marker.scale.x, marker.scale.y, marker.scale.z) == (1.0, 1.0, 1.0)
        assert marker.pose.orientation.w == 1.0
        marker.header.stamp.sec, marker.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        marker.points = [MESSAGES.vector(place, "Point") for place in places]
        color = kinds["std_msgs/msg/ColorRGBA"]
        marker.colors = [color(*map(float, one)) for one in colors]
        assert bytes(MESSAGES.pack(marker)) == data


def test_a_cloud_has_a_point_for_each_vertex_in_their_order(rng):
    positions, error = rng.normal(size=(7, 3)), rng.random(7)
    visible = rng.random(7) < 0.5
    data = vertex_cloud(5_000_000_007, "world", positions, error, visible)
    cloud = MESSAGES.store.deserialize_cdr(data, POINT_CLOUD)
    assert (cloud.header.stamp.sec, cloud.header.stamp.nanosec) == (5, 7)
    assert (cloud.height, cloud.width, cloud.row_step) == (1, 7, 7 * cloud.point_step)
    # As any reader of the format: by names, offsets and the numbers of types (7 float, 2 byte).
    letters = {7: "f", 2: "B"}
    for name, wanted in {
        "x": positions[:, 0], "y": positions[:, 1], "z": positions[:, 2],
        "expected_error_m": error, "visible": visible,
    }.items():  # fmt: skip
        (field,) = [one for one in cloud.fields if one.name == name]
        places = range(field.offset, len(cloud.data), cloud.point_step)
        layout = "<" + letters[field.datatype]
        told = [struct.unpack_from(layout, bytes(cloud.data), place)[0] for place in places]
        np.testing.assert_array_equal(told, np.asarray(wanted, np.float32))


def test_a_picture_of_counts_or_meters_is_in_meters_and_nothing_is_zero():
    from clothtrack_capture.importing.images import raw_depth_m

    film = Film()
    message = MESSAGES.image(0, film.depth[0], "16UC1", padding=6)
    np.testing.assert_array_equal(
        raw_depth_m(message, 0.00025), film.depth[0] * np.float32(0.00025), strict=True
    )
    meters = film.depth[0].astype(np.float32) / 1000
    spoiled = meters.copy()
    meters[0, :4] = 0
    spoiled[0, :4] = np.nan, np.inf, -np.inf, -1
    np.testing.assert_array_equal(
        raw_depth_m(MESSAGES.image(0, spoiled, "32FC1"), 0.001), meters, strict=True
    )
