"""What a live page shows in three dimensions: cloth, observed points, pickers, table.

The server listens on the loop-back interface only, and answers its own pages only: another web
site that is open in the same browser can neither read the scene nor press a button.
"""

import logging
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
import rich
import viser
import websockets.asyncio.server as sockets
from jaxtyping import Float, Int
from websockets.http11 import Request, Response

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import PickerPath, Table
from clothtrack.report.coloring import Coloring
from clothtrack.report.evidence import thinned
from clothtrack.report.local_page import refusal
from clothtrack.report.palette import (
    HIDDEN,
    INSIDE,
    OBSERVED,
    OUTSIDE,
    PICKER_CLOSED,
    PICKER_OPEN,
    TABLE,
    UNKNOWN,
    heat,
    rgb255,
)
from clothtrack.report.scene_data import SceneConfig

log = logging.getLogger(__name__)

LOOP_BACK = "127.0.0.1"
TONES = 12
"""Graded values are shown in so many colours: a mesh of one colour is all that can be streamed."""
DAYLIGHT = 0.4
"""Light from everywhere beside viser's lamps."""
OUT_OF_SIGHT = np.full((1, 3), -1e3, np.float32)
NO_FACE = np.zeros((1, 3), np.uint32)


class ObservedScene:
    """Points, pickers and table in a viser scene, and the eye before them."""

    def __init__(
        self,
        server: viser.ViserServer,
        *,
        eye: Camera,
        up: Float[np.ndarray, " 3"],
        points: Float[np.ndarray, "points 3"],
        pickers: Mapping[str, PickerPath],
        table: Table | None,
        config: SceneConfig | None = None,
    ) -> None:
        """Prepare for everything that happens around `points` [m, world]."""
        self._config = config or SceneConfig()
        self._paths = pickers
        # Without shadows and reflections of a room a browser that has no graphics card can follow
        # too; the light that the room gave comes from everywhere instead.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/daylight", intensity=DAYLIGHT)
        self._cloud = server.scene.add_point_cloud(
            "/observed",
            OUT_OF_SIGHT,
            rgb255(OBSERVED),
            point_size=0.6 * self._config.point_size_m,
            point_shape="circle",
        )
        self._pickers = {
            (name, closed): server.scene.add_icosphere(
                f"/picker/{name}/{'closed' if closed else 'open'}",
                self._config.picker_radius_m,
                rgb255(PICKER_CLOSED if closed else PICKER_OPEN),
                cast_shadow=False,
                receive_shadow=False,
                visible=False,
            )
            for name in pickers
            for closed in (False, True)
        }
        if table is not None:
            _add_table(server, table, points)
        _place_eye(server, eye, up, points)

    def observe(self, points: Float[np.ndarray, "_ 3"], time_s: float) -> None:
        """Show what was observed [m, world], and where the pickers were."""
        kept = thinned(points, self._config.points)
        self._cloud.points = kept.astype(np.float32) if len(kept) else OUT_OF_SIGHT
        for (name, closed), ball in self._pickers.items():
            path = self._paths[name]
            ball.position = tuple(path.position_at(time_s))
            ball.visible = path.closed_at(time_s) == closed


class ClothScene:
    """A cloth in a viser scene, in the colours of its sides, of visibility or of graded values."""

    def __init__(self, server: viser.ViserServer, mesh: ClothMesh) -> None:
        """Prepare for poses of this mesh."""
        self._faces = np.asarray(mesh.faces, np.uint32)
        vertices = np.asarray(mesh.vertices, np.float32)

        def add(
            name: str,
            color: tuple[float, float, float],
            side: Literal["front", "back", "double"] = "double",
        ) -> viser.MeshHandle:
            return server.scene.add_mesh_simple(
                f"/cloth/{name}",
                vertices,
                self._faces if side != "double" else NO_FACE,
                color=rgb255(color),
                side=side,
                cast_shadow=False,
                receive_shadow=False,
                visible=False,
            )

        tones = heat((np.arange(TONES) + 0.5) / TONES, 1.0)
        self._groups: dict[str, list[viser.MeshHandle]] = {
            "sides": [add("outside", OUTSIDE, "front"), add("inside", INSIDE, "back")],
            "visible": [add("hidden", HIDDEN), add("visible", OUTSIDE)],
            "graded": [
                *(add(f"tone_{k}", tuple(tone)) for k, tone in enumerate(tones.tolist())),
                add("unknown", UNKNOWN),
            ],
        }

    def show(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        paint: Int[np.ndarray, " faces"] | None,
        *,
        group: str = "sides",
        opacity: float = 1.0,
    ) -> None:
        """Move the cloth, and give each face the paint of that number in a group of paints.

        `paint` is None for the two sides, which need no choice.
        """
        placed = np.asarray(vertices, np.float32)
        for name, handles in self._groups.items():
            for number, handle in enumerate(handles):
                chosen = self._faces if paint is None else self._faces[paint == number]
                shown = name == group and len(chosen) > 0
                if shown and paint is None:
                    handle.vertices = placed
                elif shown:
                    # Only the corners of these faces travel, not the whole cloth once per paint.
                    used, corners = np.unique(chosen, return_inverse=True)
                    handle.vertices = placed[used]
                    handle.faces = corners.reshape(-1, 3).astype(np.uint32)
                if shown:
                    handle.opacity = None if opacity > 0.99 else opacity
                if handle.visible != shown:
                    handle.visible = shown


def face_paint(
    faces: Int[np.ndarray, "faces 3"], coloring: Coloring, step: int
) -> Int[np.ndarray, " faces"]:
    """Which tone each face has in the group "graded"; the last one where nothing is known."""
    values = coloring.values[step][faces].mean(axis=1)
    known = np.isfinite(values)
    share = np.where(known, values, 0.0) / coloring.limit
    return np.where(known, np.clip(share * TONES, 0, TONES - 1).astype(int), TONES)


@contextmanager
def local_server(port: int | None = None) -> Iterator[viser.ViserServer]:
    """A quiet viser server on the loop-back interface, stopped at the end; any free port.

    Raises:
        InvalidConfigError: the viser that is installed cannot be kept from answering other sites.
    """
    port = port or _free_port()
    with _silent_console(), _own_pages_only() as guarded:
        server = viser.ViserServer(host=LOOP_BACK, port=port, verbose=False)
    try:
        if not guarded:
            raise InvalidConfigError(
                f"viser {viser.__version__} would let any web site drive the live page; install "
                "viser 1.1.1, or write a page with --html"
            )
        log.info("viser listens on http://%s:%d", LOOP_BACK, server.get_port())
        yield server
    finally:
        with _silent_console():
            server.stop()


_one_start = threading.Lock()


@contextmanager
def _own_pages_only() -> Iterator[list[int]]:
    """Refuse foreign requests to the server that viser starts meanwhile; gives the ports guarded.

    viser has no setting for it, so its way to websockets is wrapped while it starts.
    """
    guarded: list[int] = []

    def serve(handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        def answer(connection: sockets.ServerConnection, request: Request) -> Response | None:
            hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
            refused = refusal(hosts, origins, port)
            if refused:
                return connection.respond(403, refused)
            return process_request(connection, request)

        guarded.append(port)
        return plain(handler, host, port, process_request=answer, **options)

    with _one_start:
        plain = sockets.serve
        sockets.serve = serve
        try:
            yield guarded
        finally:
            sockets.serve = plain


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


def _add_table(
    server: viser.ViserServer, table: Table, points: Float[np.ndarray, "points 3"]
) -> None:
    """A sheet with lines every 10 cm under everything the cloth reaches."""
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    centre = centre - table.heights(centre[None])[0] * table.normal
    side = 2 * np.ceil(np.linalg.norm(high - low) * 7) / 10
    server.scene.add_grid(
        "/table",
        float(side),
        float(side),
        cell_size=0.1,
        section_size=1.0,
        cell_color=(170, 165, 155),
        section_color=(170, 165, 155),
        plane_color=rgb255(TABLE),
        plane_opacity=0.55,
        shadow_opacity=0.0,
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


def _place_eye(
    server: viser.ViserServer,
    eye: Camera,
    up: Float[np.ndarray, " 3"],
    points: Float[np.ndarray, "points 3"],
) -> None:
    forward = eye.world_from_camera[:3, 2]
    distance = float((points.mean(axis=0) - eye.position) @ forward)
    server.scene.set_up_direction(tuple(up))
    server.initial_camera.position = tuple(eye.position)
    server.initial_camera.look_at = tuple(eye.position + distance * forward)
    server.initial_camera.fov = float(2 * np.arctan(0.5 * eye.height / eye.fy))
