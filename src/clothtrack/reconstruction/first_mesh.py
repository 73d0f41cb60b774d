"""A reconstruction of the first frame as tracking starts from it: front up, and flat at rest."""

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.closest_point import closest_on_mesh, interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.alignment_frame import align
from clothtrack.recordings.recording import Table

_SYMMETRIES = {
    # Turned by half about each axis: without marks nobody can tell. Turned by a quarter it would
    # be a towel of other sides: the convention lays the longer one along x, so that only a square
    # one has a quarter turn as well, and it is no member.
    "towel": ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1)),
    # Turned over about the line from hem to neck: front and back look alike, left and right too.
    "tshirt": ((1, 1, 1), (-1, 1, -1)),
}


def symmetries(kind: str) -> Float[np.ndarray, "symmetries 3"]:
    """Signs of x, y and z about the origin that relabel the cloth as a look-alike.

    The first one changes nothing. Each is a turn of the canonical pose by half, so the relabeled
    cloth is a garment of the same category; which of them it is cannot be told from depth.

    A towel has its longer side along x: a quarter turn is none of them.

    Raises:
        InvalidConfigError: for a category without a canonical pose.
    """
    if kind not in _SYMMETRIES:
        raise InvalidConfigError(
            f"kind is {kind!r}; categories with a canonical pose are {', '.join(_SYMMETRIES)}"
        )
    return np.array(_SYMMETRIES[kind], dtype=np.float64)


def front_up(
    mesh: ClothMesh, positions: Float[np.ndarray, "vertices 3"], kind: str
) -> Float[np.ndarray, "vertices 3"]:
    """The same cloth with its points named so that its front faces up, where names are a guess.

    Front and back of a garment without marks look alike, and the network names them as it pleases.
    Before anything has happened the convention decides: of all look-alike namings, the one whose
    front looks up most. Each vertex goes to where its look-alike partner is; where the partner's
    layer is cut deeper, as at the neck, it goes on beyond the edge.

    Args:
        mesh: the garment, canonical coordinates filled.
        positions: where its vertices are in the world [m], z up.
        kind: "towel" or "tshirt".
    """
    canonical, faces = np.asarray(mesh.canonical, np.float64), mesh.faces
    outward = np.sign(_upward_area(canonical, faces))
    namings = []
    for signs in symmetries(kind):
        named = positions
        if not (signs > 0).all():
            named = carried_over(canonical * signs, canonical, positions, faces)
        namings.append(named)
    # The first of those that look up as much: the network's own names where they do.
    facing = np.array([outward @ _upward_area(named, faces) for named in namings])
    return namings[int(np.argmax(facing > 0.99 * facing.max()))]


def carried_over(
    points: Float[np.ndarray, "points 3"],
    canonical: Float[np.ndarray, "vertices 3"],
    positions: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> Float[np.ndarray, "points 3"]:
    """Where points of the canonical pose are in the world [m].

    A point beside the mesh, beyond a cut edge, lies on in the plane of the nearest triangle, as far
    from it as in the canonical pose: at the edge itself such points would fall together.
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
    """Area of each triangle as seen from above [m^2], negative where it looks down."""
    a, b, c = (vertices[faces[:, corner], :2] for corner in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def laid_flat(
    rest: ClothMesh, positions: Float[np.ndarray, "vertices 3"], table: Table, height_m: float
) -> ClothMesh:
    """The flat garment on the table about where the cloth is: its rest shape in the world.

    Args:
        rest: the flat garment in its own frame [m].
        positions: where its vertices are in the world [m].
        table: horizontal.
        height_m: of its lowest vertices above the table [m].
    """
    flat = rest.vertices.astype(np.float64)
    placed = align(positions.astype(np.float64), flat, rest.vertex_areas).to_world(flat)
    placed[:, 2] += table.point[2] + height_m - placed[:, 2].min()
    return rest.with_vertices(placed)
