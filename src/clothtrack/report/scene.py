"""The scene in three dimensions as one HTML document that plays, orbits and asks nobody.

The document is viser's own client with the recorded scene inside; the server that records it
listens on the loop-back interface only and is stopped before this module returns.
"""

import logging
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
import rich
import viser
from jaxtyping import Float

from clothtrack.recordings.recording import Recording, Table
from clothtrack.report.evidence import thinned
from clothtrack.report.overlay import scene_view
from clothtrack.report.palette import (
    INSIDE,
    OBSERVED,
    OUTSIDE,
    PICKER_CLOSED,
    PICKER_OPEN,
    TABLE,
    rgb255,
)
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

log = logging.getLogger(__name__)

LOOP_BACK = "127.0.0.1"

SIDES: tuple[tuple[str, tuple[float, float, float], Literal["front", "back"]], ...] = (
    ("outside", OUTSIDE, "front"),
    ("inside", INSIDE, "back"),
)


@dataclass(frozen=True)
class SceneConfig:
    """How much goes into the scene.

    Attributes:
        points: observed points kept per frame.
        point_size_m: size of a drawn point [m].
        resolution_m: vertex positions are rounded to this [m]; rounded numbers compress well.
        picker_radius_m: radius of the ball at a picker's tip [m].
        last_frame_s: how long the last frame stays before the scene starts again [s].
    """

    points: int = 1500
    point_size_m: float = 0.0025
    resolution_m: float = 2.0**-14
    picker_radius_m: float = 0.008
    last_frame_s: float = 1.0


class ClothScene:
    """A tracked trajectory in a viser scene; `show` moves everything to one of its frames."""

    def __init__(
        self,
        server: viser.ViserServer,
        tracked: TrackedTrajectory,
        recording: Recording,
        *,
        config: SceneConfig | None = None,
    ) -> None:
        """Put cloth, table, pickers and an empty cloud into the scene, and the eye before them."""
        self._config = config or SceneConfig()
        self._tracked, self._recording = tracked, recording
        self._origin = np.round(tracked.positions[0].mean(axis=0), 3)
        scene = server.scene
        faces = tracked.mesh.faces.astype(np.uint32)
        start = self._local(tracked.positions[0])
        self.sides = tuple(
            scene.add_mesh_simple(
                f"/cloth/{name}",
                start,
                faces,
                color=rgb255(color),
                side=side,
                position=tuple(self._origin),
            )
            for name, color, side in SIDES
        )
        self.cloud = scene.add_point_cloud(
            "/observed",
            np.zeros((1, 3), np.float32),
            rgb255(OBSERVED),
            point_size=self._config.point_size_m,
            point_shape="circle",
            position=tuple(self._origin),
        )
        self._pickers = {
            (name, closed): scene.add_icosphere(
                f"/picker/{name}/{'closed' if closed else 'open'}",
                self._config.picker_radius_m,
                rgb255(PICKER_CLOSED if closed else PICKER_OPEN),
                visible=False,
            )
            for name in recording.picker_paths
            for closed in (False, True)
        }
        if recording.table is not None:
            _add_table(scene, recording.table, tracked)
        _place_eye(server, tracked, recording)

    def show(self, step: int, points: Float[np.ndarray, "points 3"]) -> None:
        """Move everything to a step of the trajectory; `points` [m, world] were observed there."""
        vertices = self._local(self._tracked.positions[step])
        for side in self.sides:
            side.vertices = vertices
        kept = thinned(points, self._config.points)
        if not len(kept):
            kept = np.full((1, 3), -1e3)  # viser wants a point; this one is out of sight
        self.cloud.points = (kept - self._origin).astype(np.float16)
        time_s = float(self._tracked.time_s[step])
        for (name, closed), ball in self._pickers.items():
            path = self._recording.picker_paths[name]
            ball.position = tuple(path.position_at(time_s))
            ball.visible = path.closed_at(time_s) == closed

    def _local(self, positions: Float[np.ndarray, "vertices 3"]) -> np.ndarray:
        grain = self._config.resolution_m
        return (np.rint((positions - self._origin) / grain) * grain).astype(np.float32)


def scene_html(
    tracked: TrackedTrajectory,
    recording: Recording,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    *,
    steps: Sequence[int] | None = None,
    config: SceneConfig | None = None,
) -> str:
    """A self-contained HTML document with the scene and its time bar, in the recording's speed.

    `clouds` holds the observed points [m, world] of each of `steps`, which are steps of the
    trajectory (all by default).
    """
    config = config or SceneConfig()
    chosen = list(range(len(tracked.frames)) if steps is None else steps)
    durations = np.append(np.diff(tracked.time_s[chosen]), config.last_frame_s)
    with local_server() as server:
        scene = ClothScene(server, tracked, recording, config=config)
        scene.show(chosen[0], clouds[0])
        recorder = server.get_scene_serializer()
        for step, points, duration in zip(chosen, clouds, durations, strict=True):
            scene.show(step, points)
            recorder.insert_sleep(max(0.0, float(duration)))
        document = recorder.as_html()
    # The page around it is light or dark as the reader's system is; so is the scene.
    return document.replace(
        "{darkMode:false}", "{darkMode:matchMedia('(prefers-color-scheme: dark)').matches}"
    )


@contextmanager
def local_server(port: int | None = None) -> Iterator[viser.ViserServer]:
    """A quiet viser server on the loop-back interface, stopped at the end; any free port."""
    port = port or _free_port()
    with _silent_console():
        server = viser.ViserServer(host=LOOP_BACK, port=port, verbose=False)
    log.info("viser listens on http://%s:%d", LOOP_BACK, server.get_port())
    try:
        yield server
    finally:
        with _silent_console():
            server.stop()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOP_BACK, 0))
        return int(probe.getsockname()[1])


@contextmanager
def _silent_console() -> Iterator[None]:
    """Keep viser's banners off standard output, which belongs to the command line."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


def _add_table(scene: viser.SceneApi, table: Table, tracked: TrackedTrajectory) -> None:
    """A sheet with lines every 10 cm under everything the cloth reaches."""
    points = tracked.positions.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    centre = centre - table.heights(centre[None])[0] * table.normal
    side = 2 * np.ceil(np.linalg.norm(high - low) * 7) / 10
    scene.add_grid(
        "/table",
        float(side),
        float(side),
        cell_size=0.1,
        section_size=1.0,
        cell_color=(170, 165, 155),
        section_color=(170, 165, 155),
        plane_color=rgb255(TABLE),
        plane_opacity=0.55,
        wxyz=_turn_from_z(table.normal),
        position=tuple(centre - 5e-4 * table.normal),
    )


def _turn_from_z(normal: Float[np.ndarray, " 3"]) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of the shortest turn from the z axis to a unit vector."""
    w, axis = 1.0 + normal[2], np.cross((0.0, 0.0, 1.0), normal)
    if w < 1e-9:
        return 0.0, 1.0, 0.0, 0.0
    quaternion = np.array([w, *axis])
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return float(w), float(x), float(y), float(z)


def _place_eye(server: viser.ViserServer, tracked: TrackedTrajectory, recording: Recording) -> None:
    view = scene_view(tracked, recording, width=800, height=600)
    forward, upward = view.world_from_camera[:3, 2], -view.world_from_camera[:3, 1]
    distance = float((tracked.positions.reshape(-1, 3).mean(axis=0) - view.position) @ forward)
    up = recording.table.normal if recording.table is not None else upward
    server.scene.set_up_direction(tuple(up))
    server.initial_camera.position = tuple(view.position)
    server.initial_camera.look_at = tuple(view.position + distance * forward)
    server.initial_camera.fov = float(2 * np.arctan(0.5 * view.height / view.fy))
