"""Compact data of a moving cloth for the 3D viewer inside a page.

Numbers are rounded to a grain, stored as differences between frames, split into low and high bytes,
and deflated. `page_scene.js` reverses this in the browser.
"""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Frame, PickerPath, Recording, Table
from clothtrack.report.coloring import Coloring
from clothtrack.report.film_colors import PALETTE_SIZE, cloud_colors, few_colors
from clothtrack.report.layers import Layers
from clothtrack.report.overlay import View
from clothtrack.report.palette import (
    HEAT,
    HIDDEN,
    INK,
    INSIDE,
    OBSERVED,
    OUTSIDE,
    PICKER_CLOSED,
    PICKER_OPEN,
    TABLE,
    UNKNOWN,
)
from clothtrack.report.viewpoint import layers_axis, upward

_POINT_SIZE_M = 0.0025
"""Size of a drawn point [m]."""

_PICKER_RADIUS_M = 0.008
"""Radius of the ball at a picker's tip [m]."""

THICKNESS_M = 0.0012
"""Thickness of the drawn cloth [m], about that of jersey."""

SCENE_POINTS = 1500
"""Largest number of observed points shown per frame."""

_CLOUD_GRAINS = 8
"""Rounding of observed points [grains], half a millimeter, since finer detail is noise."""

_STRIP_M = 0.02
"""Width of the strips by which observed points are sorted [m]."""

_FINEST_GRAIN_M = 2.0**-14
_LARGEST_INTEGER = 32_000
RANK_STEPS = 16
_UNKNOWN_VALUE = 255
_LARGEST_VALUE = 254


@dataclass(frozen=True, eq=False)
class SceneContents:
    """Contents of a page's 3D scene.

    Attributes:
        time_s: times of the frames [s].
        along: unit vector along which layers are separated.
        positions: vertices of the cloth [m]; empty if there is no mesh.
        visible: whether a camera sees the vertex; None if unknown.
        clouds: observed points of each frame [m].
        views: the recording's cameras, with the displayed parts of their pictures.
        cloud_colors: RGB of each observed point; empty if there is no color picture.
        film: RGB of each vertex from the color pictures.
    """

    frames: Int[np.ndarray, " frames"]
    time_s: Float[np.ndarray, " frames"]
    eye: Camera
    up: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    positions: Float[np.ndarray, "frames vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    ranks: Float[np.ndarray, "frames vertices"]
    visible: Bool[np.ndarray, "frames vertices"] | None = None
    clouds: Sequence[Float[np.ndarray, "_ 3"]] = ()
    pickers: Mapping[str, PickerPath] = field(default_factory=dict)
    table: Table | None = None
    colorings: Sequence[Coloring] = ()
    views: Sequence[View] = ()
    cloud_colors: Sequence[UInt8[np.ndarray, "_ 3"]] = ()
    film: UInt8[np.ndarray, "vertices 3"] | None = None


def recorded_scene(
    recording: Recording,
    frames: Sequence[Frame],
    eye: Camera,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    *,
    mesh: ClothMesh | None = None,
    positions: Float[np.ndarray, "frames vertices 3"] | None = None,
    **more: Any,
) -> SceneContents:
    """Return the scene of some frames of a recording.

    Args:
        clouds: observed points of each frame [m].
        positions: its vertices in each frame [m].
    """
    axis = layers_axis(recording, eye)
    if mesh is None or positions is None:
        positions, faces = np.zeros((len(frames), 0, 3), np.float32), np.zeros((0, 3), np.int64)
        ranks = positions[..., 0]
    else:
        faces, layers = mesh.faces, Layers(mesh, axis)
        ranks = np.stack([layers.ranks(vertices) for vertices in positions])
    return SceneContents(
        frames=np.array([frame.index for frame in frames]),
        time_s=np.array([frame.time_s for frame in frames]),
        eye=eye,
        up=upward(recording, eye),
        along=axis,
        positions=positions,
        faces=faces,
        ranks=ranks,
        clouds=clouds,
        pickers=recording.picker_paths,
        table=recording.table,
        cloud_colors=cloud_colors(recording, frames, clouds),
        **more,
    )


def packed(scene: SceneContents) -> tuple[str, str]:
    """Return a scene as a JSON header and Base64 data."""
    # In this order successive points are neighbors and similar, so they compress better.
    orders = [np.lexsort((p[:, 1], np.floor(p[:, 0] / _STRIP_M))) for p in scene.clouds]
    clouds = [points[order] for points, order in zip(scene.clouds, orders, strict=True)]
    everything = np.concatenate([scene.positions.reshape(-1, 3), *clouds])
    if not len(everything):
        everything = np.zeros((1, 3))
    low, high = (f(everything, axis=0).astype(np.float64) for f in (np.min, np.max))
    origin = (low + high) / 2
    grain = max(_FINEST_GRAIN_M, float((high - low).max()) / 2 / _LARGEST_INTEGER)

    def integers(points: Float[np.ndarray, "*rows 3"]) -> np.ndarray:
        return np.rint((points - origin) / grain).astype(np.int16)

    pack = _Packer()
    pack.differences("positions", integers(scene.positions))
    pack.plain("faces", scene.faces.astype("<u4"))
    points = integers(np.concatenate([np.empty((0, 3)), *clouds]))
    pack.shuffled("cloud", points // _CLOUD_GRAINS * _CLOUD_GRAINS + _CLOUD_GRAINS // 2)
    pack.plain("ranks", np.rint(np.clip(RANK_STEPS * scene.ranks, 0, 255)).astype(np.uint8))
    if scene.visible is not None:
        pack.plain("visible", np.packbits(scene.visible.ravel(), bitorder="little"))
    for coloring in scene.colorings:
        pack.plain(f"color {coloring.key}", _bytes_of(coloring))
    if scene.film is not None:
        pack.plain("film", scene.film)
    colors = _cloud_colors(scene, orders, pack)
    header = {
        **_facts(scene),
        "cloudColors": colors,
        "origin": origin.tolist(),
        "grain": grain,
        "vertices": int(scene.positions.shape[1]),
        "counts": [len(points) for points in clouds],
        "arrays": pack.places,
    }
    return json.dumps(header), base64.b64encode(zlib.compress(pack.content, 6)).decode("ascii")


class _Packer:
    """Concatenated arrays, and the location of each."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.places: dict[str, tuple[str, int, int, int]] = {}

    def plain(self, name: str, values: np.ndarray) -> None:
        """Append an array as bytes or as four-byte words."""
        self.content += bytes(-len(self.content) % 4)
        data = values.tobytes()
        kind = "words" if values.itemsize == 4 else "bytes"
        self.places[name] = (kind, len(self.content), len(data), 0)
        self.content += data

    def shuffled(
        self, name: str, values: np.ndarray, kind: str = "shuffled", width: int = 0
    ) -> None:
        """Append two-byte integers, first all low bytes, then all high bytes."""
        halves = values.astype("<i2").ravel().view(np.uint8).reshape(-1, 2)
        data = np.ascontiguousarray(halves.T).tobytes()
        self.places[name] = (kind, len(self.content), len(data), width)
        self.content += data

    def differences(self, name: str, values: np.ndarray) -> None:
        """Append the first frame, and the differences between successive frames."""
        first, width = np.zeros_like(values[:1]), int(np.prod(values.shape[1:]))
        self.shuffled(name, np.diff(values, axis=0, prepend=first), "differences", width)


def _cloud_colors(
    scene: SceneContents, orders: Sequence[Int[np.ndarray, " _"]], pack: _Packer
) -> list[list[int]]:
    """Pack a color index for each observed point, and return the palette."""
    if not scene.cloud_colors:
        return []
    sorted_colors = [one[order] for one, order in zip(scene.cloud_colors, orders, strict=True)]
    everything = np.concatenate([np.empty((0, 3)), *sorted_colors])
    palette, places = few_colors(everything, PALETTE_SIZE)
    pack.plain("cloud colors", places)
    return palette.tolist()


def _bytes_of(coloring: Coloring) -> np.ndarray:
    """Return 0 to 254 for zero to the limit, 255 for unknown values."""
    known = np.isfinite(coloring.values)
    share = np.clip(np.where(known, coloring.values, 0.0) / coloring.limit, 0.0, 1.0)
    return np.where(known, np.rint(_LARGEST_VALUE * share), _UNKNOWN_VALUE).astype(np.uint8)


def _facts(scene: SceneContents) -> dict[str, Any]:
    """Return the header without the arrays: eye, table, pickers, colors."""
    eye = scene.eye
    pickers = [
        {
            "tips": [path.position_at(float(time)).tolist() for time in scene.time_s],
            "closed": [bool(path.closed_at(float(time))) for time in scene.time_s],
        }
        for path in scene.pickers.values()
    ]
    table = scene.table
    return {
        "frames": scene.frames.tolist(),
        "eye": eye.position.tolist(),
        "forward": eye.world_from_camera[:3, 2].tolist(),
        "fieldOfView": float(2 * np.arctan(0.5 * eye.height / eye.fy)),
        "times": np.round(scene.time_s, 4).tolist(),
        "views": [_view(one) for one in scene.views],
        "thickness": THICKNESS_M,
        "up": scene.up.tolist(),
        "along": scene.along.tolist(),
        "table": None if table is None else [table.point.tolist(), table.normal.tolist()],
        "pickers": pickers,
        "pointSize": _POINT_SIZE_M,
        "pickerRadius": _PICKER_RADIUS_M,
        "colorings": [
            {"key": one.key, "title": one.title, "note": one.note, "limit": one.limit}
            for one in scene.colorings
        ],
        "palette": {
            "outside": OUTSIDE,
            "inside": INSIDE,
            "hidden": HIDDEN,
            "observed": OBSERVED,
            "closed": PICKER_CLOSED,
            "open": PICKER_OPEN,
            "table": TABLE,
            "ink": INK,
            "unknown": UNKNOWN,
            "heat": HEAT.tolist(),
        },
    }


def _view(view: View) -> dict[str, Any]:
    """Return the pose of a camera, and the displayed part of its picture [pixels]."""
    camera, pose = view.camera, view.camera.world_from_camera
    return {
        "name": camera.name,
        "eye": pose[:3, 3].tolist(),
        "right": pose[:3, 0].tolist(),
        "down": pose[:3, 1].tolist(),
        "forward": pose[:3, 2].tolist(),
        "focal": [camera.fx, camera.fy],
        "center": [camera.cx - view.columns.start, camera.cy - view.rows.start],
        "size": [view.columns.stop - view.columns.start, view.rows.stop - view.rows.start],
    }
