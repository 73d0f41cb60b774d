"""Publication of tracked meshes on ROS 2 topics."""

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.report.palette import UNKNOWN, heat
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.ros2.mesh_messages import (
    MARKER,
    POINT_CLOUD,
    TriangleMarker,
    vertex_cloud,
)
from clothtrack_capture.ros2.participant import Closing, Participant

_HIDDEN_ALPHA = 0.5


class Ros2Sink(Closing):
    """A publisher of meshes for RViz, and of their vertices for programs.

    The mesh is a Marker of triangles, colored by the expected error (blue to red, gray where it is
    not known) and half transparent where no camera sees it. The vertices are a PointCloud2 in
    vertex order with the fields x, y, z, expected_error_m and visible.

    Attributes:
        skipped: number of messages not sent because a reader was too slow to take them.
    """

    def __init__(
        self,
        *,
        mesh_topic: str = "/clothtrack/mesh",
        cloud_topic: str | None = "/clothtrack/vertices",
        frame_id: str = "world",
        error_limit_m: float = 0.05,
        domain_id: int | None = None,
    ) -> None:
        """Join the domain.

        Args:
            error_limit_m: expected error shown in red [m].
        """
        self._frame_id, self._error_limit_m = frame_id, error_limit_m
        self._marker = TriangleMarker(frame_id)
        self._participant = Participant(domain_id)
        self._mesh = self._participant.writer(_topic(mesh_topic, MARKER))
        self._cloud = None
        if cloud_topic is not None:
            self._cloud = self._participant.writer(_topic(cloud_topic, POINT_CLOUD))
        self.skipped = 0

    def publish(
        self,
        stamp_ns: int,
        positions: Float[np.ndarray, "vertices 3"],
        faces: Int[np.ndarray, "faces 3"],
        expected_error_m: Float[np.ndarray, " vertices"] | None = None,
        visible: Bool[np.ndarray, " vertices"] | None = None,
    ) -> None:
        """Publish a mesh.

        Args:
            stamp_ns: stamp of the picture that the mesh belongs to [ns] (`Ros2Source.stamp_ns`).
            positions: vertex positions in the world [m].
            expected_error_m: expected error of each vertex [m]; NaN or None where it is not known.
        """
        count = len(positions)
        error = np.full(count, np.nan) if expected_error_m is None else expected_error_m
        seen = np.ones(count, dtype=bool) if visible is None else visible
        rgb = np.where(np.isnan(error)[:, None], UNKNOWN, heat(error, self._error_limit_m))
        colors = np.column_stack([rgb, np.where(seen, 1.0, _HIDDEN_ALPHA)])
        mesh = self._marker.encode(stamp_ns, positions[faces.ravel()], colors[faces.ravel()])
        self.skipped += not self._mesh.write(mesh)
        if self._cloud is not None:
            cloud = vertex_cloud(stamp_ns, self._frame_id, positions, error, seen)
            self.skipped += not self._cloud.write(cloud)

    def close(self) -> None:
        """Leave the domain."""
        self._participant.close()


def _topic(name: str, kind: str) -> Topic:
    return Topic(f"/{name.lstrip('/')}", kind, cdr=True)
