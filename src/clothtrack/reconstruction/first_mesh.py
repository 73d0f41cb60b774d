"""Prepares a first-frame reconstruction as the start of tracking: front up, and flat at rest."""

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.closest_point import closest_on_mesh, interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.alignment_frame import align
from clothtrack.recordings.recording import Table

_SYMMETRIES = {
    # Half turns about each axis, which are indistinguishable without marks. The convention puts
    # the longer side along x, so a quarter turn would give a towel of other sides. Only a square
    # towel has a quarter turn as well, and it is not included.
    "towel": ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1)),
    # A half turn about the line from hem to neck: front and back look alike, left and right too.
    "tshirt": ((1, 1, 1), (-1, 1, -1)),
}


def symmetries(kind: str) -> Float[np.ndarray, "symmetries 3"]:
    """Return the symmetries of the cloth, as signs of x, y and z about the origin.

    The first one is the identity. Each other is a half turn of the canonical pose, so the relabeled
    cloth is a garment of the same category. Depth cannot distinguish them.

    A towel has its longer side along x, so a quarter turn is not among them.
    """
    if kind not in _SYMMETRIES:
        raise InvalidConfigError(
            f"kind is {kind!r}; categories with a canonical pose are {', '.join(_SYMMETRIES)}"
        )
    return np.array(_SYMMETRIES[kind], dtype=np.float64)


def front_up(
    mesh: ClothMesh, positions: Float[np.ndarray, "vertices 3"], kind: str
) -> Float[np.ndarray, "vertices 3"]:
    """Return the vertex positions relabeled by the symmetry whose front faces up most.

    Front and back of a garment without marks look alike, so the network's choice between them is
    arbitrary. In the first frame a convention decides: of all symmetries, the one whose front faces
    up most. Each vertex moves to the position of its symmetric partner. Where the partner's layer
    is cut deeper, as at the neck, the vertex is extrapolated beyond the edge.

    Args:
        positions: vertex positions in the world [m], z up.
    """
    canonical, faces = np.asarray(mesh.canonical, np.float64), mesh.faces
    outward = np.sign(_upward_area(canonical, faces))
    namings = []
    for signs in symmetries(kind):
        named = positions
        if not (signs > 0).all():
            named = carried_over(canonical * signs, canonical, positions, faces)
        namings.append(named)
    # The first of those that face up equally, which is the network's own labeling if it is one.
    facing = np.array([outward @ _upward_area(named, faces) for named in namings])
    return namings[int(np.argmax(facing > 0.99 * facing.max()))]


def carried_over(
    points: Float[np.ndarray, "points 3"],
    canonical: Float[np.ndarray, "vertices 3"],
    positions: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> Float[np.ndarray, "points 3"]:
    """Return world positions [m] of points of the canonical pose.

    A point beside the mesh, beyond a cut edge, is extrapolated in the plane of the nearest triangle
    by its distance in the canonical pose. On the edge itself such points would coincide.
    """
    face, weights = closest_on_mesh(points, canonical, faces)
    there = interpolate(weights, positions[faces[face]])
    beside = points - interpolate(weights, canonical[faces[face]])
    gap = np.linalg.norm(beside, axis=1)
    for number in np.flatnonzero(gap > 1e-9):
        corner, *others = faces[face[number]]
        sides = canonical[others] - canonical[corner]
        shares = np.linalg.lstsq(sides.T, beside[number], rcond=None)[0]
        step = shares @ (positions[others] - positions[corner])
        length = float(np.linalg.norm(step))
        there[number] += step * min(1.0, gap[number] / max(length, 1e-12))
    return there


def _upward_area(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, " faces"]:
    """Return the area of each triangle seen from above [m^2], negative if it faces down."""
    a, b, c = (vertices[faces[:, corner], :2] for corner in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def laid_flat(
    rest: ClothMesh, positions: Float[np.ndarray, "vertices 3"], table: Table, height_m: float
) -> ClothMesh:
    """Return the rest shape in the world: the flat garment on the table, aligned with the cloth.

    Args:
        rest: the flat garment in its own frame [m].
        positions: vertex positions of the cloth in the world [m].
        height_m: height of the lowest vertices above the table [m].
    """
    flat = rest.vertices.astype(np.float64)
    placed = align(positions.astype(np.float64), flat, rest.vertex_areas).to_world(flat)
    placed[:, 2] += table.point[2] + height_m - placed[:, 2].min()
    return rest.with_vertices(placed)
