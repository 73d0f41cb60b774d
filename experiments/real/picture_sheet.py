"""Contact sheets of reconstructed real pictures: color, measured heights, heights of the mesh."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.geometry import Camera, ClothMesh, Rasterizer
from clothtrack.recordings.segmentation import height_picture
from clothtrack.report.lettering import caption
from clothtrack.report.palette import PAPER, rgb255
from real.topdown import RealPicture

Picture = UInt8[np.ndarray, "height width 3"]
WIDTH, HEIGHT, GAP = 224, 168, 4
COLUMNS = 2
MARGIN_PX = 12
STICKER_RGB, CORNER_RGB = (30, 200, 30), (255, 40, 40)


def drawn_depth(mesh: ClothMesh, camera: Camera) -> Float[np.ndarray, "height width"]:
    """Return the depth of the mesh in a camera [m]; 0 where it is not."""
    depth = Rasterizer(mesh.faces, camera).render(mesh.vertices.astype(np.float64)).depth
    return np.where(np.isfinite(depth), depth, 0.0).astype(np.float64)


def tile(
    picture: RealPicture,
    mesh: ClothMesh | None,
    words: str,
    corners: Float[np.ndarray, "corners 2"],
) -> Picture:
    """Color, measured and drawn heights on one scale, words over them.

    Args:
        mesh: what it became, in the world [m]; None leaves the last part empty.
        corners: where the mesh's stickers are [pixels]: red crosses.
    """
    depth = picture.depth
    measured = np.where(depth.mask, depth.depth_m, 0.0)
    drawn = np.zeros_like(measured) if mesh is None else drawn_depth(mesh, depth.camera)
    heights = [height_picture(part, depth.camera, depth.table) for part in (measured, drawn)]
    shown = [part > 0 for part in (measured, drawn)]
    highest = max(float(np.percentile(heights[0][shown[0]], 99.0)), 0.01) if shown[0].any() else 1.0
    color = picture.color.copy()
    maps = [_heights(*part, highest) for part in zip(heights, shown, strict=True)]
    for part in (color, *maps):
        for place in [] if picture.stickers is None else picture.stickers:
            cv2.circle(part, np.rint(place).astype(int).tolist(), 14, STICKER_RGB, 3)
        for place in corners:
            at = np.rint(np.clip(place, -1e4, 1e4)).astype(int).tolist()
            cv2.drawMarker(part, at, CORNER_RGB, cv2.MARKER_CROSS, 28, 4)
    window = _around(picture.silhouette | shown[1])
    gap = np.full((HEIGHT, GAP, 3), rgb255(PAPER), np.uint8)
    parts = [piece for part in (color, *maps) for piece in (_framed(part[window]), gap)]
    joined = np.hstack(parts)
    return np.vstack([caption(joined.shape[1], words, height=24), joined])


def sheet(tiles: Sequence[Picture]) -> Picture:
    """Return tiles in two columns."""
    rows = []
    for start in range(0, len(tiles), COLUMNS):
        line = list(tiles[start : start + COLUMNS])
        line += [np.full_like(tiles[0], rgb255(PAPER))] * (COLUMNS - len(line))
        rows.append(np.hstack(line))
    return np.vstack(rows)


def _heights(
    height_m: Float[np.ndarray, "height width"],
    shown: Bool[np.ndarray, "height width"],
    highest_m: float,
) -> Picture:
    """Return heights from the table to the highest as colors, paper where nothing is shown."""
    levels = np.clip(255.0 * height_m / highest_m, 0, 255).astype(np.uint8)
    colors = cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB)
    return np.where(shown[..., None], colors, np.uint8(rgb255(PAPER)))


def _around(shown: Bool[np.ndarray, "height width"]) -> tuple[slice, slice]:
    rows, columns = np.nonzero(shown)
    top, left = max(rows.min() - MARGIN_PX, 0), max(columns.min() - MARGIN_PX, 0)
    return slice(top, rows.max() + MARGIN_PX), slice(left, columns.max() + MARGIN_PX)


def _framed(picture: Picture) -> Picture:
    scale = min(HEIGHT / picture.shape[0], WIDTH / picture.shape[1])
    size = max(1, int(picture.shape[1] * scale)), max(1, int(picture.shape[0] * scale))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    paper = np.full((HEIGHT, WIDTH, 3), rgb255(PAPER), np.uint8)
    top, left = (HEIGHT - small.shape[0]) // 2, (WIDTH - small.shape[1]) // 2
    paper[top : top + small.shape[0], left : left + small.shape[1]] = small
    return paper
