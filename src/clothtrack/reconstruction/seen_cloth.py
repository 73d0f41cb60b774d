"""One picture of a cloth in the form that a fit uses: from above, where cloth may be and how high.

Everything is stored at the few thousand pixels of the network's own picture, because a fit queries
it hundreds of times.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_closing, distance_transform_edt
from scipy.spatial import cKDTree

from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.data.view import CroppedView
from clothtrack.reconstruction.depth_input import DepthInput

CLOSED_PIXELS = 2
"""Gaps in the mask up to twice as wide [pixels] are treated as unmeasured cloth."""

_STEEP_M = 0.015
"""A vertex with a correction shorter than this [m] moves straight down or sideways, because lying
layers are no thicker. The quick fit of hanging cloth is equally good with 2, 15 and 30 mm. Crumpled
cloth of real pictures is a little worse with 2 mm, so a larger value is used."""

_TALL_M = 0.015
"""An object beside the mask that rises this high over the table [m] may hide cloth."""


@dataclass(frozen=True, eq=False)
class SeenCloth:
    """The space where a cloth may be, from straight above.

    Attributes:
        depth: depth along its axis [m]; 0 where no cloth was measured.
        free: pixels where cloth may be: cloth was seen there, or could not have been seen.
        table_m: height of the table in the world [m].
    """

    camera: Camera
    depth: Float[np.ndarray, "height width"]
    free: Bool[np.ndarray, "height width"]
    table_m: float

    @classmethod
    def of(cls, view: CroppedView, picture: DepthInput, table_m: float) -> "SeenCloth":
        """Return the cloth that a picture shows.

        Args:
            table_m: height of the table [m].
        """
        seen = view.depth > 0
        # Pad the mask so that closing does not erode it at the picture's border.
        wide = np.pad(seen, CLOSED_PIXELS)
        closed = np.asarray(binary_closing(wide, iterations=CLOSED_PIXELS), bool)
        inner = slice(CLOSED_PIXELS, -CLOSED_PIXELS)
        free = closed[inner, inner] | seen | _unknown(view.camera, picture, table_m)
        return cls(view.camera, view.depth, free, table_m)

    @cached_property
    def seen(self) -> Bool[np.ndarray, "height width"]:
        """Pixels in which cloth was measured."""
        return self.depth > 0

    @cached_property
    def points(self) -> Float[np.ndarray, "points 3"]:
        """An evenly spaced quarter of the measured points [m]; all if the quarter is empty."""
        every = np.zeros(self.depth.shape, bool)
        every[::2, ::2] = True
        chosen = self.seen & every
        depth = self.depth.astype(np.float64)
        return self.camera.back_project(depth, chosen if chosen.any() else self.seen)

    @cached_property
    def tree(self) -> cKDTree:
        """k-d tree of the points."""
        return cKDTree(self.points)

    @cached_property
    def extent_m(self) -> float:
        """Root of the visible area [m], as if it lay on the table."""
        pixel_m = (self.camera.position[2] - self.table_m) / self.camera.fx
        return float(np.sqrt(self.seen.sum()) * pixel_m)

    @cached_property
    def longest_m(self) -> float:
        """Longest horizontal extent of the visible cloth [m]."""
        level = self.points[:, :2] - self.points[:, :2].mean(axis=0)
        angles = np.arange(0.0, np.pi, np.pi / 12.0)
        along = level @ np.stack([np.cos(angles), np.sin(angles)])
        low, high = np.percentile(along, [0.5, 99.5], axis=0)
        return float((high - low).max())

    def cells(
        self, count: int
    ) -> tuple[Float[np.ndarray, "count count"], Float[np.ndarray, "count count"]]:
        """Return the share of each cell showing cloth, and its mean height over the table [m]."""
        side = self.depth.shape[0] // count
        blocks = (count, side, count, side)
        covered = self.seen.reshape(blocks).mean(axis=(1, 3))
        top = np.where(self.seen, self.camera.position[2] - self.table_m - self.depth, 0.0)
        height_m = top.reshape(blocks).mean(axis=(1, 3)) / np.maximum(covered, 1e-9)
        return covered, height_m

    @cached_property
    def _nearest_free(self) -> Int[np.ndarray, "2 height width"]:
        """Row and column of the free pixel nearest to each pixel."""
        return _nearest(self.free)

    @cached_property
    def _top_m(self) -> Float[np.ndarray, "height width"]:
        """Height of the cloth at each pixel [m], from the nearest measured pixel."""
        rows, columns = _nearest(self.seen)
        return self.camera.position[2] - self.depth[rows, columns]

    def confined(
        self, vertices: Float[np.ndarray, "vertices 3"]
    ) -> Float[np.ndarray, "vertices 3"]:
        """Return the nearest positions [m] where cloth may be.

        That is in a free pixel and below the visible surface, or on a measured point if one is
        nearer. Hanging cloth is steep, so a vertex beside it may be a few millimeters from a
        measured point but centimeters above the surface. If such vertices were moved down in every
        iteration and never up, the whole cloth would sink.

        Args:
            vertices: current positions [m].
        """
        camera = self.camera
        away = camera.position[2] - vertices[:, 2]
        column = (vertices[:, 0] - camera.position[0]) / away * camera.fx + camera.cx
        row = (camera.position[1] - vertices[:, 1]) / away * camera.fy + camera.cy
        height, width = self.depth.shape
        at_row = np.clip(np.rint(row), 0, height - 1).astype(np.intp)
        at_column = np.clip(np.rint(column), 0, width - 1).astype(np.intp)
        to_row, to_column = self._nearest_free[:, at_row, at_column]
        outside = ~self.free[at_row, at_column]
        moved = vertices.copy()
        scale = away / camera.fx
        moved[:, 0] += np.where(outside, (to_column - column) * scale, 0.0)
        moved[:, 1] -= np.where(outside, (to_row - row) * scale, 0.0)
        np.minimum(moved[:, 2], self._top_m[at_row, at_column], out=moved[:, 2])
        shift_m = np.linalg.norm(moved - vertices, axis=1)
        far = np.flatnonzero(shift_m > _STEEP_M)
        if len(far) and len(self.points):
            aside_m, point = self.tree.query(vertices[far], distance_upper_bound=shift_m[far].max())
            nearer = aside_m < shift_m[far]
            moved[far[nearer]] = self.points[point[nearer]]
        np.maximum(moved[:, 2], self.table_m, out=moved[:, 2])
        return moved


def _nearest(marked: Bool[np.ndarray, "height width"]) -> Int[np.ndarray, "2 height width"]:
    """Return row and column of the marked pixel that is nearest to each pixel."""
    found = distance_transform_edt(~marked, return_distances=False, return_indices=True)
    return np.asarray(found)


def _unknown(
    camera: Camera, picture: DepthInput, table_m: float
) -> Bool[np.ndarray, "height width"]:
    """Return virtual-camera pixels in which the sensor could not have seen cloth on the table."""
    shape = camera.height, camera.width
    to_table = np.full(shape, camera.position[2] - table_m)
    if not (to_table > 0.0).all():
        return np.zeros(shape, bool)
    pixels, depth = picture.camera.project(camera.back_project(to_table))
    columns, rows = np.rint(pixels).T
    inside = (depth > 0) & (rows >= 0) & (rows < picture.camera.height)
    inside &= (columns >= 0) & (columns < picture.camera.width)
    at = rows[inside].astype(np.intp), columns[inside].astype(np.intp)
    measured = picture.depth_m[at]
    # The view is steep enough that the ray to the table gives the height of an object.
    tall = (measured > 0) & (measured < depth[inside] * (1.0 - _TALL_M / camera.position[2]))
    unknown = ~inside
    unknown[inside] = tall & ~picture.mask[at]
    whole = unknown.reshape(shape).astype(np.uint8)
    # Remove single pixels, which are noise.
    return cv2.morphologyEx(whole, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(bool)
