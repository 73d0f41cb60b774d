"""Simplification of a marching-cubes surface to a cloth mesh: manifold, one piece, no slivers."""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

ROUNDS = 12
"""Largest number of rounds, each of which collapses edges that do not touch."""

_LEAST_AGREEMENT = 0.2
"""Least cosine of the angle by which a triangle may turn when an adjacent edge is collapsed."""

_SLIVER = 0.02
"""Share of the usual area below which a triangle has no reliable normal."""

Vertices = Float[np.ndarray, "vertices 3"]
Faces = Int[np.ndarray, "faces 3"]
_FacesKept = Int[np.ndarray, "faces_kept 3"]


def largest_piece(faces: Int[np.ndarray, "faces 3"]) -> Int[np.ndarray, "kept 3"]:
    """Return the faces of the edge-connected component with most faces."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, edge = np.unique(sides, axis=0, return_inverse=True)
    owner = np.repeat(np.arange(len(faces)), 3)
    ones = np.ones(len(owner), dtype=np.int8)
    touches = sparse.coo_array((ones, (owner, edge.ravel()))).tocsr()
    _, piece = connected_components(touches @ touches.T, directed=False)
    return faces[piece == np.bincount(piece).argmax()]


def without_pinches(faces: Int[np.ndarray, "faces 3"]) -> Int[np.ndarray, "kept 3"]:
    """Return the faces with a single fan at each vertex, keeping the larger fan."""
    while True:
        drop = np.zeros(len(faces), dtype=bool)
        for vertex in _pinched(faces).tolist():
            around = np.flatnonzero((faces == vertex).any(axis=1))
            fans = _fans(faces[around], vertex)
            drop[around[fans != np.bincount(fans).argmax()]] = True
        if not drop.any():
            return faces
        faces = faces[~drop]


def without_short_edges(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], shortest: float
) -> tuple[Float[np.ndarray, "kept 3"], Int[np.ndarray, "faces_kept 3"]]:
    """Return the same surface with short edges collapsed.

    An edge is kept if its collapse would join two layers, close an opening or fold a triangle over
    (the link condition of Dey et al., 1999, and a limit on the turn of normals). So a manifold
    stays a manifold with the same openings.

    Args:
        vertices: positions [m].
        shortest: length below which edges are collapsed [m].
    """
    for turn in range(ROUNDS):
        # An edge that may not collapse blocks its neighbors, so reverse the order in every second
        # round.
        target, collapsed = _collapse_once(vertices, faces, shortest, -1 if turn % 2 else 1)
        if not collapsed:
            break
        vertices, faces = target
    return compact(vertices, faces)


def compact(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> tuple[Float[np.ndarray, "kept 3"], Int[np.ndarray, "faces 3"]]:
    """Return the vertices used by faces, in order, and the faces with new indices."""
    used, numbers = np.unique(faces, return_inverse=True)
    return vertices[used], numbers.reshape(faces.shape).astype(np.int32)


def _collapse_once(
    vertices: Vertices, faces: Faces, shortest: float, way: int
) -> tuple[tuple[Vertices, _FacesKept], int]:
    """Collapse independent edges, from short to long (`way` 1) or in reverse."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(sides, axis=0, return_counts=True)
    rim = np.zeros(len(vertices), dtype=bool)
    rim[edges[counts == 1]] = True
    lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    closes = (counts == 2) & rim[edges].all(axis=1)
    short = np.flatnonzero((lengths < shortest) & ~closes)
    short = short[np.argsort(lengths[short], kind="stable")][::way]
    kept, gone = _independent(edges, counts, short).T
    moved_to = np.arange(len(vertices))
    moved_to[gone] = kept
    # Collapse to the middle, but keep a rim in place.
    blend = 0.5 * (1.0 + rim[gone] - rim[kept])[:, None]
    places = vertices.copy()
    places[kept] = places[gone] = (1.0 - blend) * vertices[kept] + blend * vertices[gone]
    _undo_folded(vertices, places, moved_to, faces, np.stack([kept, gone], axis=1))
    collapsed = int((moved_to != np.arange(len(vertices))).sum())
    faces = moved_to[faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return (places, faces[whole]), collapsed


def _independent(
    edges: Int[np.ndarray, "edges 2"], counts: Int[np.ndarray, " edges"], order: np.ndarray
) -> Int[np.ndarray, "chosen 2"]:
    """Return edges, in this order of preference, whose rings of neighbors do not meet.

    They satisfy the link condition: the ends share as many neighbors as faces.
    """
    beside: dict[int, set[int]] = {}
    for a, b in edges.tolist():
        beside.setdefault(a, set()).add(b)
        beside.setdefault(b, set()).add(a)
    blocked: set[int] = set()
    chosen = []
    for (a, b), faces_beside in zip(edges[order].tolist(), counts[order].tolist(), strict=True):
        ring = beside[a] | beside[b]
        if not blocked.isdisjoint(ring) or len(beside[a] & beside[b]) != faces_beside:
            continue
        blocked |= ring
        chosen.append((a, b))
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)


def _undo_folded(
    vertices: Vertices,
    places: Vertices,
    moved_to: Int[np.ndarray, " vertices"],
    faces: Faces,
    collapses: Int[np.ndarray, "collapses 2"],
) -> None:
    """Undo, in place, the collapses that turn an adjacent face too far."""
    owner = np.full(len(vertices), -1)
    owner[collapses] = np.arange(len(collapses))[:, None]
    moving = owner[faces].max(axis=1)
    after = moved_to[faces]
    stays = (after != np.roll(after, 1, axis=1)).all(axis=1) & (moving >= 0)
    before, turned = _normals(vertices[faces[stays]]), _normals(places[after[stays]])
    size = np.linalg.norm(before, axis=1)
    lengths = size * np.linalg.norm(turned, axis=1)
    agreement = np.einsum("fi,fi->f", before, turned)
    # The normal of a sliver is meaningless.
    counts = size > _SLIVER * np.median(np.linalg.norm(_normals(vertices[faces]), axis=1))
    folded = counts & (agreement <= _LEAST_AGREEMENT * lengths)
    back = collapses[np.unique(moving[stays][folded])].ravel()
    places[back], moved_to[back] = vertices[back], back


def _normals(corners: Float[np.ndarray, "faces 3 3"]) -> Float[np.ndarray, "faces 3"]:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _pinched(faces: Faces) -> Int[np.ndarray, " pinched"]:
    """Return vertices where several fans of faces meet: at least two edges more than faces."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    count = int(faces.max()) + 1 if len(faces) else 0
    edges_at = np.bincount(edges.ravel(), minlength=count)
    return np.flatnonzero(edges_at - np.bincount(faces.ravel(), minlength=count) >= 2)


def _fans(around: Faces, vertex: int) -> Int[np.ndarray, " around"]:
    """Return the fan of each face around a vertex; faces of a fan share edges at the vertex."""
    beside = np.zeros((len(around), len(around)), dtype=bool)
    for other in np.setdiff1d(around, vertex):
        members = np.flatnonzero((around == other).any(axis=1))
        beside[members[0], members] = True
    return connected_components(sparse.csr_array(beside), directed=False)[1]
