"""Shaded stills of a cloth from any camera, with our own z-buffer and without OpenGL.

Both sides of the cloth have their own hue, so that layers pushed through each other show as
speckle. Depth steps are drawn dark, and parts below their surroundings are dimmed (depth
darkening, Luft, Colditz and Deussen, "Image enhancement by unsharp masking the depth buffer",
SIGGRAPH 2006), which makes thin layers readable.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import DepthBuffer, Rasterizer
from clothtrack.recordings.recording import Table
from clothtrack.recordings.segmentation import bounds_of
from clothtrack.report.palette import INSIDE, OUTSIDE, PAPER, TABLE

GRID_M = 0.1
"""Spacing of the lines on the table [m]."""

_DEPTH_DARKENING_M = 0.025
"""Depth below its surroundings at which cloth is fully dimmed [m]."""


@dataclass(frozen=True)
class ShadingConfig:
    """Settings of a still.

    Attributes:
        ambient: share of ambient light.
        light: direction towards the light in the camera's frame (x right, y down, z forward).
        edge_darkening: darkness of depth steps, 0..1.
        depth_darkening: dimming of parts deeper than their surroundings, 0..1.
        supersampling: pixels computed per pixel and axis; 2 smooths the outlines.
    """

    ambient: float = 0.42
    light: tuple[float, float, float] = (-0.45, -0.55, -0.70)
    edge_darkening: float = 0.55
    depth_darkening: float = 0.38
    supersampling: int = 1


@dataclass(frozen=True, eq=False)
class ShadedStill:
    """Shaded picture with the mask of the cloth.

    Attributes:
        image: RGB picture.
        cloth: mask of the pixels that show cloth.
    """

    image: UInt8[np.ndarray, "height width 3"]
    cloth: Bool[np.ndarray, "height width"]


class Shader:
    """Renderer of one cloth from one camera; caches buffers and the picture of the table."""

    def __init__(
        self,
        faces: Int[np.ndarray, "faces 3"],
        camera: Camera,
        *,
        table: Table | None = None,
        config: ShadingConfig | None = None,
    ) -> None:
        """Prepare the view of `camera`; without a `table` the background stays empty."""
        self.config = config or ShadingConfig()
        self.size = (camera.width, camera.height)
        self.camera = camera.resized(camera.width * self.config.supersampling)
        self._faces = np.asarray(faces, dtype=np.int32)
        self._rasterizer = Rasterizer(self._faces, self.camera)
        self._backdrop, self._backdrop_depth = _backdrop(self.camera, table)
        self._empty = _eight_bits(self._backdrop)

    def render(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        *,
        colors: Float[np.ndarray, "vertices 3"] | None = None,
    ) -> ShadedStill:
        """Render the cloth at `vertices` [m, world], two-sided or in `colors` per vertex."""
        buffer = self._rasterizer.render(vertices)
        cloth = (buffer.faces >= 0) & (buffer.depth < self._backdrop_depth + 2e-3)
        picture = self._empty.copy()
        if cloth.any():
            # The picture does not change beyond the reach of the depth darkening.
            box = bounds_of(cloth, margin=math.ceil(4 * _shade_reach(self.camera)) + 2)
            picture[box] = self._drawn(vertices, buffer, cloth, box, colors=colors)
        if self.config.supersampling > 1:
            picture = cv2.resize(picture, self.size, interpolation=cv2.INTER_AREA)
            share = cv2.resize(cloth.astype(np.float32), self.size, interpolation=cv2.INTER_AREA)
            cloth = share >= 0.5
        return ShadedStill(picture, cloth)

    def _drawn(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        buffer: DepthBuffer,
        cloth: Bool[np.ndarray, "height width"],
        box: tuple[slice, slice],
        *,
        colors: Float[np.ndarray, "vertices 3"] | None,
    ) -> UInt8[np.ndarray, "rows columns 3"]:
        """Return the part of the picture inside a box."""
        image, behind = self._backdrop[box].copy(), self._backdrop_depth[box]
        image[cloth[box]] = self._shade(vertices, buffer, cloth, colors)
        depth = np.where(cloth[box], buffer.depth[box], behind)
        image *= _darkening(depth, behind, cloth[box], self.camera, self.config)[..., None]
        return _eight_bits(image)

    def _shade(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        buffer: DepthBuffer,
        cloth: Bool[np.ndarray, "height width"],
        colors: Float[np.ndarray, "vertices 3"] | None,
    ) -> Float[np.ndarray, "pixels 3"]:
        """Return Lambert shading of the cloth's pixels, with interpolated normals."""
        camera, config = self.camera, self.config
        local = camera.camera_from_world_points(vertices).astype(np.float32)
        rows, columns = np.nonzero(cloth)
        face, z = buffer.faces[cloth], buffer.depth[cloth]
        rays = np.stack(
            [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(len(z))], 1
        ).astype(np.float32)
        first, along_b, along_c, normals = _triangles(local, self._faces)
        offset = rays * z[:, None] - first[face]
        weight_b = np.einsum("pi,pi->p", offset, along_b[face])[:, None]
        weight_c = np.einsum("pi,pi->p", offset, along_c[face])[:, None]

        def interpolate(values: Float[np.ndarray, "vertices k"]) -> Float[np.ndarray, "pixels k"]:
            a, b, c = (values[self._faces[:, corner]] for corner in range(3))
            return a[face] + weight_b * (b - a)[face] + weight_c * (c - a)[face]

        front = np.einsum("pi,pi->p", normals[face], rays) < 0
        smooth = interpolate(_vertex_normals(normals, self._faces, len(vertices)))
        smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-12)
        light = np.asarray(config.light, dtype=np.float32)
        lambert = smooth @ (light / np.linalg.norm(light)) * np.where(front, 1.0, -1.0)
        brightness = config.ambient + (1.08 - config.ambient) * np.clip(lambert, 0.0, 1.0)
        if colors is None:
            sides = np.array([INSIDE, OUTSIDE], dtype=np.float32)
            base = sides[front.astype(np.int64)]
        else:
            base = np.clip(interpolate(np.asarray(colors, dtype=np.float32)), 0.0, 1.0)
        return (base * brightness[:, None]).astype(np.float32)


def _eight_bits(image: Float[np.ndarray, "*pixels 3"]) -> UInt8[np.ndarray, "*pixels 3"]:
    """Return colors from 0 to 1 as bytes."""
    return np.rint(np.clip(image, 0.0, 1.0) * 255).astype(np.uint8)


def _shade_reach(camera: Camera) -> float:
    """Return the standard deviation [pixels] of the blur in depth darkening."""
    return max(2.0, 0.010 * camera.width)


def _triangles(
    local: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return first corners, two vectors whose dot products give barycentrics, area normals."""
    a, b, c = (local[faces[:, corner]] for corner in range(3))
    first, second = b - a, c - a
    normals = np.cross(first, second)
    squared = np.maximum((normals**2).sum(axis=1, keepdims=True), 1e-20)
    along_b = np.cross(second, normals) / squared
    along_c = np.cross(normals, first) / squared
    return a, along_b, along_c, normals


def _vertex_normals(
    normals: Float[np.ndarray, "faces 3"], faces: Int[np.ndarray, "faces 3"], count: int
) -> Float[np.ndarray, "vertices 3"]:
    """Return the sum of the area normals around each vertex."""
    corners = faces.ravel()
    sums = [
        np.bincount(corners, weights=np.repeat(normals[:, axis], 3), minlength=count)
        for axis in range(3)
    ]
    return np.stack(sums, axis=1).astype(np.float32)


def _backdrop(
    camera: Camera, table: Table | None
) -> tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
    """Return the picture without cloth, and its depth [m] (infinite where empty)."""
    image = np.empty((camera.height, camera.width, 3), dtype=np.float32)
    image[:] = PAPER
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    if table is None:
        return image, depth
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    local = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)], -1
    )
    rays = local @ camera.world_from_camera[:3, :3].T
    falling = -(rays @ table.normal)
    height = float((camera.position - table.point) @ table.normal)
    with np.errstate(divide="ignore"):
        reach = height / falling
    reach[~((reach > 0) & (reach < 50 * abs(height)))] = np.inf
    hit = np.isfinite(reach)
    depth[hit] = reach[hit]
    points = camera.position + rays[hit] * reach[hit][:, None]
    fade = np.clip(1.6 - 0.45 * reach[hit] / np.median(reach[hit]), 0.0, 1.0)
    paint = np.full(fade.shape, 1.0)
    paint -= 0.09 * _grid_lines(points - table.point, table.normal, GRID_M)
    color = np.asarray(TABLE) * paint[:, None]
    image[hit] = fade[:, None] * color + (1 - fade[:, None]) * np.asarray(PAPER)
    return image, depth


def _grid_lines(
    points: Float[np.ndarray, "points 3"], normal: Float[np.ndarray, " 3"], spacing_m: float
) -> Float[np.ndarray, " points"]:
    """Return the intensity of grid lines at points of a plane, 0..1."""
    first = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(np.cross(normal, first), normal)
    first /= np.linalg.norm(first)
    across = np.stack([points @ first, points @ np.cross(normal, first)], axis=1) / spacing_m
    nearest = np.abs(across - np.rint(across)).min(axis=1)
    return np.clip(1.6 - nearest / 0.0125, 0.0, 1.0)


def _darkening(
    depth: Float[np.ndarray, "height width"],
    backdrop_depth: Float[np.ndarray, "height width"],
    cloth: Bool[np.ndarray, "height width"],
    camera: Camera,
    config: ShadingConfig,
) -> Float[np.ndarray, "height width"]:
    """Return the brightness from depth steps (outlines, folds) and depth darkening."""
    farthest = float(depth[cloth].max())
    filled = np.where(np.isfinite(depth), depth, farthest).astype(np.float32)
    bend = np.abs(cv2.Laplacian(filled, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE))
    footprint = filled / camera.fx
    step = np.clip((bend - 1.5 * footprint) / (2e-3 + 3.0 * footprint), 0.0, 1.0)
    outline = cloth & (cv2.erode(cloth.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    step = np.where(outline, 1.0, np.where(cloth, step, 0.0))
    behind = np.where(np.isfinite(backdrop_depth), backdrop_depth, farthest)
    raised = np.where(cloth, behind - depth, 0.0).astype(np.float32)
    around = cv2.GaussianBlur(raised, (0, 0), _shade_reach(camera))
    below = np.clip((around - raised) / _DEPTH_DARKENING_M, 0.0, 1.0)
    below[~np.isfinite(depth)] = 0.0
    return (1.0 - config.edge_darkening * step) * (1.0 - config.depth_darkening * below)
