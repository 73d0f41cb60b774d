"""Two sets of real pictures from above: garments folded by hand, cloths with stickers.

`garments/` has depth of a structured-light camera, masks and `meta.json` (`frames`: `id`,
`garment`; `intrinsics`). `stickers/` has maps of height in 8 bits over no background, and
`meta.json` (`frames`: `frame`, `cloth`, `corner_stickers` as u, v in pixels). Whatever frames
`meta.json` names are taken.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.depth_input import DepthInput, from_picture
from clothtrack.recordings.pictures import read_color, read_mask
from clothtrack.recordings.point_cloud import cloth_measured
from clothtrack.recordings.recording import Table

GARMENTS, STICKERS = "garments", "stickers"

KINDS = {"tshirt": "tshirt", "polo": "tshirt", "sweater": "tshirt"}
"""The network's garment by the set's; all others are towels."""

PIXEL_M = 0.30 / 480
"""Side of a pixel of `stickers/` [m]: the flat square fills 480, and is taken for 30 cm."""

STICKER_INSET = 0.045
"""From a corner to the middle of its sticker, in parts of the longer side; along the diagonal."""

USUAL_SIDE_M = 0.30
"""Longer side of a cloth in `stickers/` that has no flat picture [m]."""

CAMERA_HEIGHT_M = 10.0
"""Of the camera that `stickers/` is given [m]: so far away that its picture is a map."""

LEVEL, LEVELS_PER_M = 192.5, 2000.0
"""Value of the table in a map of heights, and by how much it falls with each meter."""

LEAST_HEIGHT_M = -0.003
"""A pixel of a map that is lower is none of the cloth: its rim, mixed with the background [m]."""


@dataclass(frozen=True, eq=False)
class RealPicture:
    """One picture, and what is known of it.

    Attributes:
        silhouette: where the cloth is, measured or not.
        color: the same view in color, red first.
        size_m: longer and shorter side of the cloth [m], where they are known.
        stickers: column and row of the corners' stickers that can be seen [pixels].
    """

    depth: DepthInput
    silhouette: Bool[np.ndarray, "height width"]
    color: UInt8[np.ndarray, "height width 3"]
    size_m: tuple[float, float] | None = None
    stickers: Float[np.ndarray, "stickers 2"] | None = None


@dataclass(frozen=True)
class Entry:
    """A picture that is not read yet."""

    name: str
    garment: str
    kind: str
    read: Callable[[], RealPicture]


def garments(folder: Path) -> list[Entry]:
    """Return the pictures of folded garments."""
    meta = _meta(folder, "intrinsics", "id", "garment")

    def entry(frame: dict) -> Entry:
        name = f"{frame['id']:02d}" if isinstance(frame["id"], int) else str(frame["id"])
        kind = KINDS.get(frame["garment"], "towel")
        return Entry(
            name, frame["garment"], kind, lambda: _garment(folder, name, meta["intrinsics"])
        )

    return [entry(frame) for frame in meta["frames"]]


def stickers(folder: Path) -> list[Entry]:
    """Return the pictures of cloths with stickers on their corners."""
    frames = _meta(folder, None, "frame", "cloth", "corner_stickers")["frames"]

    def entry(frame: dict) -> Entry:
        marks = np.array([(s["u"], s["v"]) for s in frame["corner_stickers"]], dtype=np.float64)
        name, cloth = frame["frame"], frame["cloth"]
        return Entry(
            name, cloth, "towel", lambda: _sticker_cloth(folder, name, cloth, marks.reshape(-1, 2))
        )

    return [entry(frame) for frame in frames]


SETS: dict[str, Callable[[Path], list[Entry]]] = {GARMENTS: garments, STICKERS: stickers}


def least_rectangle(silhouette: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "4 2"]:
    """Return corners (column, row) of the smallest rectangle around the pixels, in their order."""
    rows, columns = np.nonzero(silhouette)
    pixels = np.stack([columns, rows], axis=1).astype(np.float32)
    return cv2.boxPoints(cv2.minAreaRect(pixels)).astype(np.float64)


def sides_of(rectangle: Float[np.ndarray, "4 2"]) -> tuple[float, float]:
    """Return longer and shorter side of a rectangle [pixels]; its corners are middles of pixels."""
    lengths = np.linalg.norm(rectangle[[1, 2]] - rectangle[[0, 1]], axis=1) + 1.0
    return float(lengths.max()), float(lengths.min())


def _garment(folder: Path, name: str, intrinsics: dict) -> RealPicture:
    fx, fy = intrinsics["fx"], intrinsics["fy"]
    if abs(fx - fy) > 0.01 * fx:
        raise InvalidRecordingError(
            f"{folder / 'meta.json'}: fx is {fx} and fy {fy}; only square pixels are read"
        )
    mask = folder / "mask" / f"{name}.png"
    depth = from_picture(
        folder / "depth" / f"{name}.png",
        mask=mask,
        depth_unit_m=intrinsics.get("depth_unit_m", 0.001),
        focal=0.5 * (fx + fy),
        principal_point=(intrinsics["cx"], intrinsics["cy"]),
    )
    return RealPicture(depth, read_mask(mask), read_color(folder / "color" / f"{name}.png"))


def _sticker_cloth(
    folder: Path, name: str, cloth: str, marks: Float[np.ndarray, "stickers 2"]
) -> RealPicture:
    level = _map(folder, name)
    flat = folder / "depth" / f"{cloth}_00.png"
    # The cloth's sides are where it lies flat.
    known = sides_of(least_rectangle(_map(folder, f"{cloth}_00") < 255)) if flat.exists() else None
    height_m = (LEVEL - level) / LEVELS_PER_M
    silhouette = level < 255
    measured = silhouette & (height_m > LEAST_HEIGHT_M)
    depth_m = np.where(measured, CAMERA_HEIGHT_M - height_m, 0.0)
    rows, columns = level.shape
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = CAMERA_HEIGHT_M
    focal = CAMERA_HEIGHT_M / PIXEL_M
    camera = Camera("map", columns, rows, focal, focal, (columns - 1) / 2, (rows - 1) / 2, pose)
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    return RealPicture(
        DepthInput(depth_m, cloth_measured(depth_m, silhouette, camera), camera, table, "towel"),
        silhouette,
        read_color(folder / "color" / f"{name}.png"),
        None if known is None else (PIXEL_M * known[0], PIXEL_M * known[1]),
        marks,
    )


def _map(folder: Path, name: str) -> Float[np.ndarray, "height width"]:
    path = folder / "depth" / f"{name}.png"
    level = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if level is None:
        raise InvalidRecordingError(f"{path}: cannot be read; it must be a map of 8 bits")
    return level.astype(np.float64)


def _meta(folder: Path, head: str | None, *keys: str) -> dict:
    path = folder / "meta.json"
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
        missing = [head] if head and head not in meta else []
        missing += [key for frame in meta["frames"] for key in keys if key not in frame]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidRecordingError(f"{path}: cannot be read ({error})") from error
    if missing:
        raise InvalidRecordingError(f"{path}: there is no {missing[0]!r}")
    return meta
