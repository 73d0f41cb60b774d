"""Pictures of a flat garment, with the outline of the garment on the table."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.files.extras import install_command
from clothtrack.garments.silhouettes import Silhouette, silhouette
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.availability import missing_modules
from clothtrack.recordings.pictures import GRAY, read_color, read_depth, read_header, read_mask
from clothtrack.recordings.recording import Table
from clothtrack.recordings.segmentation import (
    HeightSegmenter,
    default_segmenter,
    height_picture,
    main_components,
)
from clothtrack.recordings.store import read_recording

_FLATTEST_M = 0.05
"""A garment is not flat if a twentieth of its pixels are higher above the table than this [m]."""

_RIM_SHARE = 0.06
"""Width of the rim of a color picture that shows only the table, over the picture's width."""


@dataclass(frozen=True, eq=False)
class FlatPicture:
    """A flat garment as a camera saw it from above.

    Attributes:
        outline: outline of the garment on the table [m].
        shown: picture to draw on, RGB.
    """

    outline: Silhouette
    shown: UInt8[np.ndarray, "height width 3"]
    name: str


def flat_recording(folder: Path, frame: int = 0) -> FlatPicture:
    """Read a frame of a recording in which the garment lies flat."""
    recording = read_recording(folder)
    if not 0 <= frame < len(recording.frames):
        raise InvalidRecordingError(
            f"{folder}: there is no frame {frame}; it has 0 to {len(recording.frames) - 1}"
        )
    shown_by, name = recording.frames[frame], f"{folder}, frame {frame}"
    camera = next((one for one in recording.cameras if one.name in shown_by.depth), None)
    if camera is None or recording.table is None:
        missing = "table" if camera else "depth picture"
        raise InvalidRecordingError(
            f"{name}: it has no {missing}, so that nothing says how large the garment is; give a "
            "recording with table and depth, or a picture with --meters-per-pixel"
        )
    depth = read_depth(shown_by.depth[camera.name], recording.depth_units_m[camera.name])
    color = read_color(shown_by.color[camera.name]) if camera.name in shown_by.color else None
    mask = default_segmenter(recording, shown_by, camera)(color, depth, camera, recording.table)
    return _measured(depth, mask, camera, recording.table, name=name, color=color)


def flat_depth(path: Path, *, mask: Path | None = None, **of_picture: Any) -> FlatPicture:
    """Read a 16-bit depth picture; `of_picture` as for `depth_input.from_picture`."""
    if missing := missing_modules():
        raise InvalidConfigError(
            f"{path}: a single depth picture needs {', '.join(missing)}; install with: "
            f"{install_command('learn')}, or give a recording or a color picture"
        )
    from clothtrack.reconstruction.depth_input import from_picture

    picture = from_picture(path, mask=mask, **of_picture)
    table = picture.table or Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    # The outline includes the rim of the cloth, where depth is missing.
    whole = (
        read_mask(mask)
        if mask is not None
        else HeightSegmenter()(None, picture.depth_m, picture.camera, table)
    )
    return _measured(picture.depth_m, whole, picture.camera, table, name=str(path))


def flat_color(path: Path, meters_per_pixel: float, *, mask: Path | None = None) -> FlatPicture:
    """Read a color picture or a mask of a camera that looks straight down.

    Args:
        meters_per_pixel: size of a pixel on the table [m].
    """
    if not 0.0 < meters_per_pixel < 0.1:
        raise InvalidConfigError(
            f"meters_per_pixel is {meters_per_pixel}; give the size of a pixel on the table in "
            "meters, such as 0.0015"
        )
    shown = read_color(path)
    height, width = shown.shape[:2]
    if mask is not None:
        marked = read_mask(mask)
    elif read_header(path).color_type == GRAY:
        marked = read_mask(path)
    else:
        marked = _unlike_the_rim(shown)
    if marked.shape != (height, width):
        raise InvalidRecordingError(
            f"{mask} has {marked.shape[1]} x {marked.shape[0]} pixels, {path} has {width} x "
            f"{height}; give a mask of the same picture"
        )
    scale = np.array([meters_per_pixel, -meters_per_pixel])
    return FlatPicture(
        silhouette(marked, lambda pixels: pixels * scale, str(path)), shown, str(path)
    )


def _measured(
    depth: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"],
    camera: Camera,
    table: Table,
    *,
    name: str,
    color: UInt8[np.ndarray, "height width 3"] | None = None,
) -> FlatPicture:
    heights = height_picture(depth, camera, table)[mask & (depth > 0)]
    top = float(np.percentile(heights, 95)) if len(heights) else 0.0
    if top > _FLATTEST_M:
        raise InvalidRecordingError(
            f"{name}: the cloth rises {100 * top:.0f} cm above the table (at most "
            f"{100 * _FLATTEST_M:.0f}): it is not flat, or the mask shows something else; "
            f"smooth it "
            "out and take the picture again"
        )

    def to_plane(pixels: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
        focal, center = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
        local = np.column_stack([(pixels - center) / focal, np.ones(len(pixels))])
        rays = local @ camera.world_from_camera[:3, :3].T
        reach = ((table.point - camera.position) @ table.normal) / (rays @ table.normal)
        return (camera.position + reach[:, None] * rays - table.point) @ _plane_axes(table).T

    return FlatPicture(
        silhouette(mask, to_plane, name), _shades(depth) if color is None else color, name
    )


def _unlike_the_rim(
    shown: UInt8[np.ndarray, "height width 3"],
) -> Bool[np.ndarray, "height width"]:
    """Return pixels that differ in color from the table, whose lighting may vary."""
    height, width = shown.shape[:2]
    lab = cv2.cvtColor(shown.astype(np.float32) / 255.0, cv2.COLOR_RGB2LAB)
    y, x = np.mgrid[-1.0 : 1.0 : height * 1j, -1.0 : 1.0 : width * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    rim = np.maximum(np.abs(x), np.abs(y)) > 1.0 - 2.0 * _RIM_SHARE
    light = np.linalg.lstsq(terms[rim], lab[rim], rcond=None)[0]
    # Lightness has half weight, because a shadow changes lightness alone.
    apart = np.linalg.norm((lab - terms @ light) * (0.5, 1.0, 1.0), axis=2)
    apart = cv2.GaussianBlur(np.clip(4.0 * apart, 0, 255).astype(np.uint8), (0, 0), 1.0)
    _, marked = cv2.threshold(apart, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return main_components(marked > 0)


def _plane_axes(table: Table) -> Float[np.ndarray, "2 3"]:
    """Return two directions in the table that are a right-handed pair seen from above."""
    along = np.eye(3)[int(np.abs(table.normal).argmin())]
    first = along - (along @ table.normal) * table.normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(table.normal, first)])


def _shades(depth: Float[np.ndarray, "height width"]) -> UInt8[np.ndarray, "height width 3"]:
    """Return a depth picture in gray, with near points bright."""
    seen = depth[depth > 0]
    low, high = np.percentile(seen, [1, 99]) if len(seen) else (0.0, 1.0)
    share = np.clip((high - depth) / max(float(high - low), 1e-6), 0.0, 1.0)
    gray = np.where(depth > 0, 60 + 180 * share, 0).astype(np.uint8)
    return np.repeat(gray[:, :, None], 3, axis=2)
