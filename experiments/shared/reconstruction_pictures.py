"""Pictures of a reconstruction: depth, canonical picture, mesh, in one line with words over it."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table
from clothtrack.report.palette import PAPER, caption, rgb255, write
from clothtrack.report.shading import Shader, ShadingConfig

Picture = UInt8[np.ndarray, "height width 3"]
HEIGHT, WIDTH = 132, 168
GAP = 3


def depth_picture(
    depth_m: Float[np.ndarray, "height width"], mask: Bool[np.ndarray, "height width"]
) -> Picture:
    """Return the measured cloth, near is light; cut to what is around it."""
    shown = mask & (depth_m > 0)
    if not shown.any():
        return blank("no cloth")
    near, far = np.percentile(depth_m[shown], [1.0, 99.0])
    gray = 1.0 - np.clip((depth_m - near) / max(far - near, 1e-3), 0.0, 1.0)
    colors = np.where(shown[..., None], (40 + 200 * gray[..., None]), rgb255(PAPER))
    rows, columns = np.nonzero(shown)
    cut = colors[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    return framed(cut.astype(np.uint8))


def mesh_picture(mesh: ClothMesh | None, camera: Camera, table: Table | None, why: str) -> Picture:
    """Return the mesh from a camera of this size; without one, why there is none."""
    if mesh is None:
        return blank(why)
    shader = Shader(mesh.faces, camera, table=table, config=ShadingConfig(supersampling=2))
    return shader.render(mesh.vertices.astype(np.float64)).image.copy()


def blank(words: str) -> Picture:
    """Return a blank picture with a few words."""
    paper = np.full((HEIGHT, WIDTH, 3), rgb255(PAPER), np.uint8)
    for number, part in enumerate(words.split(": ")):
        write(paper, part[:28], (6, 24 + 16 * number), height_px=9.0)
    return paper


def framed(picture: Picture) -> Picture:
    """Return a picture of any size in the middle of one of ours."""
    scale = min(HEIGHT / picture.shape[0], WIDTH / picture.shape[1])
    size = max(1, int(picture.shape[1] * scale)), max(1, int(picture.shape[0] * scale))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
    paper = np.full((HEIGHT, WIDTH, 3), rgb255(PAPER), np.uint8)
    top, left = (HEIGHT - small.shape[0]) // 2, (WIDTH - small.shape[1]) // 2
    paper[top : top + small.shape[0], left : left + small.shape[1]] = small
    return paper


def line(pictures: Sequence[Picture], words: tuple[str, str]) -> Picture:
    """Return pictures side by side, words over them."""
    gap = np.full((HEIGHT, GAP, 3), rgb255(PAPER), np.uint8)
    joined = np.hstack([part for each in pictures for part in (each, gap)][:-1])
    return np.vstack([caption(joined.shape[1], *words, height=22), joined])
