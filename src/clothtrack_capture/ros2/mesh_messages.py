"""Mesh messages for RViz and controllers: a Marker of triangles and a PointCloud2."""

import struct
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from clothtrack_capture.importing.messages import message_store

MARKER = "visualization_msgs/msg/Marker"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
_STAMP = slice(4, 12)
_VERTEX = np.dtype(
    {
        "names": ["x", "y", "z", "expected_error_m", "visible"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "u1"],
        "offsets": [0, 4, 8, 12, 16],
        "itemsize": 20,
    }
)


class TriangleMarker:
    """An encoder for Markers of type TRIANGLE_LIST, one per picture.

    The standard writers make an object of every point and color, which takes longer than the time
    between pictures. Here the two arrays are inserted into a message that was written without them.
    """

    def __init__(self, frame_id: str) -> None:
        """Write the message without triangles."""
        bare, one = (_bare_marker(frame_id, points) for points in ([], [_made("Point")]))
        # They differ first at the number of points, where both arrays follow.
        pairs = enumerate(zip(bare, one, strict=False))
        self._counts_at = next(place for place, (mine, other) in pairs if mine != other)
        self._bare = bare

    def encode(
        self,
        stamp_ns: int,
        corners: Float[np.ndarray, "corners 3"],
        colors: Float[np.ndarray, "corners 4"],
    ) -> bytes:
        """Return the message as CDR.

        Args:
            stamp_ns: time in its header [ns].
            corners: three corners of each triangle [m].
        """
        place, count = self._counts_at, struct.pack("<I", len(corners))
        # No padding is needed: doubles are aligned to eight bytes, and so is the end of the count.
        return b"".join([
            _stamped(self._bare[:place], stamp_ns), count, corners.astype("<f8").tobytes(),
            count, colors.astype("<f4").tobytes(), self._bare[place + 8 :],
        ])  # fmt: skip


def vertex_cloud(
    stamp_ns: int,
    frame_id: str,
    positions: Float[np.ndarray, "vertices 3"],
    expected_error_m: Float[np.ndarray, " vertices"],
    visible: Bool[np.ndarray, " vertices"],
) -> bytes:
    """Return a PointCloud2 as CDR, with one point per vertex in vertex order.

    Args:
        stamp_ns: time in its header [ns].
        positions: vertex positions [m].
        expected_error_m: expected error of each vertex [m]; NaN where it is not known.
    """
    points = np.zeros(len(positions), _VERTEX)
    for axis, name in enumerate("xyz"):
        points[name] = positions[:, axis]
    points["expected_error_m"], points["visible"] = expected_error_m, visible
    fields = [
        _made("PointField", name=name, offset=kind[1], datatype=2 if name == "visible" else 7,
              count=1)
        for name, kind in (_VERTEX.fields or {}).items()
    ]  # fmt: skip
    message = _made(
        "PointCloud2", header=_header(stamp_ns, frame_id), height=1, width=len(points),
        fields=fields, is_bigendian=False, point_step=_VERTEX.itemsize,
        row_step=points.nbytes, data=points.view(np.uint8), is_dense=True,
    )  # fmt: skip
    return bytes(message_store(cdr=True).serialize_cdr(message, POINT_CLOUD, little_endian=True))


def _stamped(head: bytes, stamp_ns: int) -> bytes:
    stamp = struct.pack("<iI", stamp_ns // 10**9, stamp_ns % 10**9)
    return head[: _STAMP.start] + stamp + head[_STAMP.stop :]


def _bare_marker(frame_id: str, points: list[Any]) -> bytes:
    store = message_store(cdr=True)
    kinds: Any = store.types[MARKER]
    nothing = np.zeros(0, np.uint8)
    message = _made(
        "Marker", header=_header(0, frame_id), ns="clothtrack", id=0, type=kinds.TRIANGLE_LIST,
        action=kinds.ADD,
        pose=_made("Pose", position=_made("Point"), orientation=_made("Quaternion", w=1.0)),
        scale=_made("Vector3", x=1.0, y=1.0, z=1.0), color=_made("ColorRGBA", a=1.0),
        lifetime=_made("Duration", sec=0, nanosec=0), frame_locked=False, points=points, colors=[],
        texture_resource="", texture=_made("CompressedImage", header=_header(0, ""), format="",
                                           data=nothing),
        uv_coordinates=[], text="", mesh_resource="",
        mesh_file=_made("MeshFile", filename="", data=nothing), mesh_use_embedded_materials=False,
    )  # fmt: skip
    return bytes(store.serialize_cdr(message, MARKER, little_endian=True))


_PACKAGES = {
    "Marker": "visualization_msgs",
    "MeshFile": "visualization_msgs",
    "ColorRGBA": "std_msgs",
    "Header": "std_msgs",
    "Time": "builtin_interfaces",
    "Duration": "builtin_interfaces",
    "CompressedImage": "sensor_msgs",
    "PointCloud2": "sensor_msgs",
    "PointField": "sensor_msgs",
}


def _made(kind: str, **content: Any) -> Any:
    """Return a message of a type; numbers that are not given are 0."""
    name = f"{_PACKAGES.get(kind, 'geometry_msgs')}/msg/{kind}"
    store = message_store(cdr=True)
    missing = [field for field, _ in store.fielddefs[name][1] if field not in content]
    return store.types[name](**content, **dict.fromkeys(missing, 0.0))


def _header(stamp_ns: int, frame_id: str) -> Any:
    stamp = _made("Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return _made("Header", stamp=stamp, frame_id=frame_id)
