"""Extraction of a garment's surface from a field of winding numbers, with open openings.

A garment of two layers encloses a volume. The winding number is about 1 inside and 0 outside, and
the surface is where it crosses 0.5. A single sheet encloses nothing, but the winding number jumps
from 0.5 to -0.5 across it, so its surface is at 0. In both cases the level set continues through
the openings, or beyond the rim, where the number changes slowly. Faces there are cut away
(GarmentNets, arXiv 2104.05177, section 3.4).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_gradient_magnitude, map_coordinates
from skimage.measure import marching_cubes

from clothtrack.errors import InvalidConfigError, InvalidMeshError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack_lab.published_networks.canonical_frame import CanonicalFrame
from clothtrack_lab.published_networks.network_config import NetworkConfig
from clothtrack_lab.published_networks.simplification import (
    compact,
    largest_piece,
    without_pinches,
    without_short_edges,
)

_LEVELS = {"towel": 0.0, "tshirt": 0.5}
"""Winding number on the surface of each category."""

_LEAST_FACES = 20
"""Least number of faces of a garment."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface found in a field.

    Attributes:
        mesh: mesh in its canonical pose [m], with the same canonical coordinates; None without
            surface.
        status: "surface", or the reason why there is none.
    """

    mesh: ClothMesh | None
    status: str


@dataclass(frozen=True)
class FieldGrid:
    """The nodes at which winding numbers are computed: a box of a grid over the unit cube.

    Attributes:
        per_edge: number of nodes along an edge of the cube, corners included.
        first: index of the box's first node along each axis.
        shape: number of nodes of the box along each axis.
    """

    per_edge: int
    first: tuple[int, int, int]
    shape: tuple[int, int, int]

    def to_unit(self, places: Float[np.ndarray, "places 3"]) -> Float[np.ndarray, "places 3"]:
        """Return positions given in nodes of the box as positions in the unit cube."""
        return (places + np.asarray(self.first)) / (self.per_edge - 1)

    @property
    def nodes(self) -> Float[np.ndarray, "nodes 3"]:
        """Nodes in the unit cube; z runs fastest."""
        return self.to_unit(np.indices(self.shape).reshape(3, -1).T.astype(np.float64))


def field_grid(frame: CanonicalFrame, config: NetworkConfig) -> FieldGrid:
    """Return the nodes that garments of a category can reach: few layers for flat ones."""
    half = np.asarray(frame.half_m)
    box = frame.to_unit(np.stack([-half, half]))
    low, high = box * (config.grid - 1)
    first = np.maximum(np.floor(low).astype(int) - config.grid_margin, 0)
    last = np.minimum(np.ceil(high).astype(int) + config.grid_margin, config.grid - 1)
    x, y, z = (int(one) for one in first)
    a, b, c = (int(one) for one in last - first + 1)
    return FieldGrid(config.grid, (x, y, z), (a, b, c))


def extract_surface(
    field: Float[np.ndarray, "x y z"], frame: CanonicalFrame, config: NetworkConfig
) -> Surface:
    """Return the largest component of a garment's surface, as a mesh that the solver can use."""
    if frame.kind not in _LEVELS:
        raise InvalidConfigError(
            f"kind is {frame.kind!r}; a surface is known for {', '.join(_LEVELS)}"
        )
    level = _LEVELS[frame.kind]
    low, high = float(field.min()), float(field.max())
    if not low < level < high:
        return Surface(
            None, f"no surface: winding numbers from {low:.2f} to {high:.2f} never pass {level}"
        )
    # "ascent" orients the faces outward: the number decreases outwards, and upwards through a sheet
    # whose faces point up.
    places, faces, _, _ = marching_cubes(
        field.astype(np.float32), level, gradient_direction="ascent", allow_degenerate=False
    )
    change = gaussian_gradient_magnitude(field.astype(np.float64), config.trim_sigma)
    steep = map_coordinates(change, places.T, order=1, mode="nearest") > config.trim
    faces = faces[steep[faces].all(axis=1)]
    if len(faces) == 0:
        return Surface(None, f"no surface: nowhere does it change by {config.trim} per node")
    faces = largest_piece(without_pinches(largest_piece(faces)))
    if len(faces) < _LEAST_FACES:
        return Surface(None, f"no surface: its largest piece has {len(faces)} faces")
    grid = field_grid(frame, config)
    canonical = frame.to_meters(grid.to_unit(places.astype(np.float64)))
    vertices, faces = compact(canonical, faces)
    shortest = config.short_edge / ((grid.per_edge - 1) * frame.scale)
    if len(vertices) > config.surface_vertices:
        shortest = max(shortest, _SHORT * _edge_for(vertices, faces, config.surface_vertices))
    vertices, faces = without_short_edges(vertices, faces, shortest)
    try:
        return Surface(ClothMesh(vertices, faces, vertices.copy()), "surface")
    except InvalidMeshError as error:
        return Surface(None, f"no surface: {error}")


_SHORT = 0.75
"""Collapsing all edges below this share of a length leaves edges of about that length."""


def _edge_for(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], count: int
) -> float:
    """Return the edge [m] of equilateral triangles that cover the surface with `vertices`."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    return float(np.sqrt(area / (count * np.sqrt(0.75))))
