"""Noise-free rendering of the simulated camera's view of table, cloth and tool."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack_lab.world.tool import Tool

TABLE, CLOTH, TOOL, TIP = 0, 1, 2, 3


@dataclass(frozen=True, eq=False)
class View:
    """The surface seen by each pixel of one picture; all arrays are in single precision.

    Attributes:
        depth: distance along the optical axis [m].
        label: surface label: `TABLE`, `CLOTH`, `TOOL` or, at the end of the tool, `TIP`.
        height: height of the surface above the table [m].
        normals: unit normal of the surface; smooth on the cloth, where its sign is arbitrary.
        facing: cosine between the surface's normal and the line of sight; 1 seen from the front.
        material: canonical coordinates [m] of the cloth's pixels, row by row.
        hidden_share: share of the cloth's pixels that the tool hides.
    """

    depth: Float[np.ndarray, "height width"]
    label: UInt8[np.ndarray, "height width"]
    height: Float[np.ndarray, "height width"]
    normals: Float[np.ndarray, "height width 3"]
    facing: Float[np.ndarray, "height width"]
    material: Float[np.ndarray, "cloth_pixels 3"]
    hidden_share: float


class Scene:
    """A cloth and a tool over the table z = 0, seen by one camera."""

    def __init__(self, cloth: ClothMesh, tool: Tool, camera: Camera) -> None:
        """Prepare the buffers for this cloth's triangles; each view takes its vertices."""
        self.camera = camera
        self._cloth = cloth
        self._canonical = cloth.vertices if cloth.canonical is None else cloth.canonical
        self._tool = tool
        self._draw_cloth = Rasterizer(cloth.faces, camera)
        self._draw_tool = Rasterizer(tool.faces, camera)
        columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        local = [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy]
        rays = np.stack([*local, np.ones(columns.shape)], axis=-1)
        self._rays = (rays @ camera.world_from_camera[:3, :3].T).reshape(-1, 3)
        self._sight = _unit(self._rays)
        self._table_depth = -camera.position[2] / self._rays[:, 2]

    @property
    def table_points(self) -> Float[np.ndarray, "height width 3"]:
        """Table point [m] on the line of sight of every pixel."""
        points = self.camera.position + self._rays * self._table_depth[:, None]
        return points.reshape(self.camera.height, self.camera.width, 3)

    def view(
        self, vertices: Float[np.ndarray, "vertices 3"], tip: Float[np.ndarray, " 3"] | None
    ) -> View:
        """Return the view for these cloth vertices and this tool tip [m]; None for no tool."""
        depth = self._table_depth.astype(np.float32)
        label = np.full(len(depth), TABLE, dtype=np.uint8)
        height = np.zeros(len(depth), dtype=np.float32)
        normals = np.zeros((len(depth), 3), dtype=np.float32)
        normals[:, 2] = 1.0
        facing = np.abs(self._sight[:, 2]).astype(np.float32)
        cloth, rod_shown = self._draw_cloth.render(vertices), np.zeros(0, dtype=int)
        cloth_depth = cloth.depth.ravel()
        if tip is not None:
            corners = self._tool.vertices(tip)
            rod = self._draw_tool.render(corners)
            rod_depth = rod.depth.ravel()
            rod_shown = np.flatnonzero(rod_depth < np.minimum(depth, cloth_depth))
            rod_faces = rod.faces.ravel()[rod_shown]
            depth[rod_shown] = rod_depth[rod_shown]
            label[rod_shown] = np.where(self._tool.tip_faces[rod_faces], TIP, TOOL)
            rod_normals = _unit(_face_vectors(corners, self._tool.faces))
            normals[rod_shown] = rod_normals[rod_faces]

        shown = np.flatnonzero(cloth_depth < depth)
        depth[shown], label[shown] = cloth_depth[shown], CLOTH
        faces = self._cloth.faces[cloth.faces.ravel()[shown]]
        points = self.camera.position + self._rays[shown] * depth[shown, None]
        height[shown] = points[:, 2]
        weights = _barycentric(points, vertices[faces])
        material = interpolate(weights, self._canonical[faces])
        corner_normals = _corner_normals(vertices, self._cloth.faces)
        normals[shown] = _unit(interpolate(weights, corner_normals[cloth.faces.ravel()[shown]]))
        for pixels in (shown, rod_shown):
            facing[pixels] = np.abs(_dot(normals[pixels], self._sight[pixels]))
        shape = (self.camera.height, self.camera.width)
        return View(
            depth.reshape(shape),
            label.reshape(shape),
            height.reshape(shape),
            normals.reshape(*shape, 3),
            facing.reshape(shape),
            material.astype(np.float32),
            1.0 - len(shown) / max(int(np.isfinite(cloth_depth).sum()), 1),
        )

    def turn_tool(self, azimuth_rad: float) -> None:
        """Set the direction in which the tool leaves its tip, seen from above."""
        self._tool = replace(self._tool, azimuth_rad=azimuth_rad)

    def out_of_picture(self, tip: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Return the tip position [m] after the tool retracts along its axis out of view."""
        away = tip
        while np.isfinite(self._draw_tool.render(self._tool.vertices(away)).depth).any():
            away = away + 0.05 * self._tool.axis
        return away


def _barycentric(
    points: Float[np.ndarray, "points 3"], corners: Float[np.ndarray, "points 3 3"]
) -> Float[np.ndarray, "points 3"]:
    """Return the weights of the three corners at each point, clipped to the triangle."""
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    uu, uv, vv, wu, wv = (_dot(p, q) for p, q in ((u, u), (u, v), (v, v), (w, u), (w, v)))
    area = np.maximum(uu * vv - uv * uv, 1e-18)
    second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)


def _dot(
    a: Float[np.ndarray, "points 3"], b: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, " points"]:
    return np.einsum("pc,pc->p", a, b)


def _unit(vectors: Float[np.ndarray, "vectors 3"]) -> Float[np.ndarray, "vectors 3"]:
    return vectors / np.maximum(np.sqrt(_dot(vectors, vectors)), 1e-12)[:, None]


def _face_vectors(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, "faces 3"]:
    """Return the normal of each face, with a length of twice its area."""
    corners = vertices[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _corner_normals(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, "faces 3 3"]:
    """Return the normal at each corner of each face.

    It is the normal of the smooth surface, or the face's own normal at a crease. At a seam of two
    layers the smooth normals cancel, and the faces' own normals remain.
    """
    weighted = _face_vectors(vertices, faces)
    smooth = np.zeros((len(vertices), 3))
    for k in range(3):
        np.add.at(smooth, faces[:, k], weighted)
    smooth, flat = _unit(smooth), _unit(weighted)
    corners = smooth[faces]
    crease = np.einsum("fkc,fc->fk", corners, flat) < 0.5
    return np.where(crease[..., None], flat[:, None], corners)
