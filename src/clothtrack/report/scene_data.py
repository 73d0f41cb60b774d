"""A cloth in motion, packed small enough to lie inside a page, for the page's own viewer.

Numbers are rounded to a grain, taken as differences from frame to frame, split into low and high
bytes and deflated; `page_scene.js` undoes this in the browser.
"""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.recording import PickerPath, Table
from clothtrack.report.coloring import Coloring
from clothtrack.report.evidence import thinned
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

POINT_SIZE_M = 0.0025
"""Size of a drawn point [m]."""

PICKER_RADIUS_M = 0.008
"""Radius of the ball at a picker's tip [m]."""

FINEST_GRAIN_M = 2.0**-14
LARGEST_INTEGER = 32_000
RANK_STEPS = 16
UNKNOWN_VALUE = 255
LARGEST_VALUE = 254


@dataclass(frozen=True)
class SceneConfig:
    """How much goes into a scene.

    Attributes:
        points: observed points kept per frame.
    """

    points: int = 1500


@dataclass(frozen=True, eq=False)
class SceneContents:
    """What a page shows in three dimensions.

    Attributes:
        frames: numbers of the frames.
        time_s: when they were [s].
        eye: from where to look first.
        up: unit vector upwards.
        along: unit vector along which layers are taken apart.
        positions: vertices of the cloth [m]; none where there is no mesh.
        faces: vertex indices per triangle.
        ranks: how many layers lie under each vertex.
        visible: whether a camera sees the vertex; None where nobody knows.
        clouds: observed points of each frame [m].
        pickers: where the pickers were.
        table: where the table is.
        colorings: what the cloth can be coloured by.
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


def packed(scene: SceneContents, config: SceneConfig | None = None) -> tuple[str, str]:
    """A scene as a JSON header and Base64 data."""
    config = config or SceneConfig()
    clouds = [thinned(np.asarray(points), config.points) for points in scene.clouds]
    everything = np.concatenate([scene.positions.reshape(-1, 3), *clouds]).astype(np.float64)
    if not len(everything):
        everything = np.zeros((1, 3))
    low, high = everything.min(axis=0), everything.max(axis=0)
    origin = (low + high) / 2
    grain = max(FINEST_GRAIN_M, float((high - low).max()) / 2 / LARGEST_INTEGER)

    def integers(points: Float[np.ndarray, "*rows 3"]) -> np.ndarray:
        return np.rint((points - origin) / grain).astype(np.int16)

    pack = _Packer()
    pack.differences("positions", integers(scene.positions))
    pack.plain("faces", scene.faces.astype("<u4"))
    pack.shuffled("cloud", integers(np.concatenate([np.empty((0, 3)), *clouds])))
    pack.plain("ranks", np.rint(np.clip(RANK_STEPS * scene.ranks, 0, 255)).astype(np.uint8))
    if scene.visible is not None:
        pack.plain("visible", np.packbits(scene.visible.ravel(), bitorder="little"))
    for coloring in scene.colorings:
        pack.plain(f"color {coloring.key}", _bytes_of(coloring))
    header = {
        **_facts(scene),
        "origin": origin.tolist(),
        "grain": grain,
        "vertices": int(scene.positions.shape[1]),
        "counts": [len(points) for points in clouds],
        "arrays": pack.places,
    }
    return json.dumps(header), base64.b64encode(zlib.compress(pack.content, 6)).decode("ascii")


class _Packer:
    """Arrays one after the other, and where each lies."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.places: dict[str, tuple[str, int, int]] = {}

    def plain(self, name: str, values: np.ndarray) -> None:
        """Bytes, or words of four bytes, as they are."""
        self.content += bytes(-len(self.content) % 4)
        data = values.tobytes()
        self.places[name] = ("words" if values.itemsize == 4 else "bytes", len(self.content),
                             len(data))  # fmt: skip
        self.content += data

    def shuffled(self, name: str, values: np.ndarray, kind: str = "shuffled") -> None:
        """Integers of two bytes: first all low bytes, then all high ones."""
        halves = values.astype("<i2").ravel().view(np.uint8).reshape(-1, 2)
        data = np.ascontiguousarray(halves.T).tobytes()
        self.places[name] = (kind, len(self.content), len(data))
        self.content += data

    def differences(self, name: str, values: np.ndarray) -> None:
        """The first frame, and what changes from each frame to the next."""
        first = np.zeros_like(values[:1])
        self.shuffled(name, np.diff(values, axis=0, prepend=first), "differences")


def _bytes_of(coloring: Coloring) -> np.ndarray:
    """0 to 254 for nothing to the limit, 255 for not known."""
    known = np.isfinite(coloring.values)
    share = np.clip(np.where(known, coloring.values, 0.0) / coloring.limit, 0.0, 1.0)
    return np.where(known, np.rint(LARGEST_VALUE * share), UNKNOWN_VALUE).astype(np.uint8)


def _facts(scene: SceneContents) -> dict[str, Any]:
    """What is not an array: eye, table, pickers, colours."""
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
        "up": scene.up.tolist(),
        "along": scene.along.tolist(),
        "table": None if table is None else [table.point.tolist(), table.normal.tolist()],
        "pickers": pickers,
        "pointSize": POINT_SIZE_M,
        "pickerRadius": PICKER_RADIUS_M,
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
