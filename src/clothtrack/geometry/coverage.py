"""Coverage: the area of the table that a cloth hides, layers counted once."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.geometry.mesh import sides_of

_PERTURBATION = 1e-9
_PAIRS_AT_ONCE = 1 << 20


def projected_area(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> float:
    """Return the area [m^2] of the union of all triangles, seen along a direction.

    No raster is used. The boundary of the union consists of pieces of mesh edges (hems and
    silhouettes) that no triangle covers from outside, and Green's theorem turns these pieces into
    the area. Clipping with three lines gives the part of an edge that a triangle covers. No
    polygons are assembled, so rounding moves ends of pieces but cannot break the result.

    Layers that coincide exactly (a garment flat on itself) would be ambiguous; vertices are
    therefore shifted by random amounts of a billionth of the mesh's extent first. The result is
    exact to about 1e-8, relative. `normal` is the direction of view, of any length.
    """
    points = _projected(np.asarray(vertices, np.float64), np.asarray(normal, np.float64))
    edges, opposite = _boundary_candidates(points, faces)
    if not len(edges):
        return 0.0
    start, end = points[edges[:, 0]], points[edges[:, 1]]
    # Orient every edge with the inside on its left.
    turn = _cross(end - start, points[opposite] - start) < 0
    start[turn], end[turn] = end[turn], start[turn].copy()
    edge, first, last = _covered(points, faces, edges, start, end)
    return _uncovered_area(start, end, edge, first, last)


def _projected(vertices: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return two coordinates across the normal, centered, in general position."""
    normal = normal / np.linalg.norm(normal)
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    right = np.cross(helper, normal)
    right /= np.linalg.norm(right)
    points = vertices @ np.stack([right, np.cross(normal, right)], axis=1)
    points = points - points.mean(axis=0)
    noise = np.random.default_rng(0).uniform(-1, 1, points.shape)
    return points + _PERTURBATION * np.abs(points).max(initial=0.0) * noise


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _boundary_candidates(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return edges with all triangles on one side, and the opposite corner of one of these."""
    keys, far = sides_of(faces), faces[:, [2, 0, 1]].reshape(-1)
    side = _cross(points[keys[:, 1]] - points[keys[:, 0]], points[far] - points[keys[:, 0]]) > 0
    edges, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    index = index.reshape(-1)
    left = np.bincount(index, weights=side, minlength=len(edges))
    one_sided = (left == 0) | (left == np.bincount(index, minlength=len(edges)))
    return edges[one_sided], far[first[one_sided]]


def _covered(
    points: np.ndarray,
    faces: np.ndarray,
    edges: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return parts of edges (0 to 1 along each) inside triangles that do not contain the edge."""
    corners = points[faces]
    clockwise = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    centers = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centers[:, None], axis=2).max(axis=1)
    tree = cKDTree(centers)
    reach = 0.5 * np.linalg.norm(end - start, axis=1) + radii.max()
    near = tree.query_ball_point(0.5 * (start + end), reach)
    counts = np.array([len(each) for each in near])
    parts = []
    # Process neighboring edges together, with no more pairs than fit into memory.
    group = np.cumsum(counts) // _PAIRS_AT_ONCE
    for members in np.split(np.arange(len(edges)), np.flatnonzero(np.diff(group)) + 1):
        edge = np.repeat(members, counts[members])
        face = np.concatenate([near[each] for each in members]).astype(np.int64)
        shared = (faces[face][:, :, None] == edges[edge][:, None, :]).any(axis=1).all(axis=1)
        edge, face = edge[~shared], face[~shared]
        first, last = _clip(start[edge], end[edge], corners[face])
        inside = last > first
        parts.append((edge[inside], first[inside], last[inside]))
    edge, first, last = (np.concatenate(column) for column in zip(*parts, strict=True))
    return edge, first, last


def _clip(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last position (0 to 1) of segments in counterclockwise triangles."""
    first, last = np.zeros(len(start)), np.ones(len(start))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        side = corners[:, b] - corners[:, a]
        at_start = _cross(side, start - corners[:, a])
        at_end = _cross(side, end - corners[:, a])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = at_start / (at_start - at_end)
        enters = (at_start < 0) & (at_end >= 0)
        leaves = (at_start >= 0) & (at_end < 0)
        outside = (at_start < 0) & (at_end < 0)
        first = np.where(enters, np.maximum(first, crossing), first)
        last = np.where(leaves, np.minimum(last, crossing), last)
        last = np.where(outside, -1.0, last)
    return first, last


def _uncovered_area(
    start: np.ndarray, end: np.ndarray, edge: np.ndarray, first: np.ndarray, last: np.ndarray
) -> float:
    """Return Green's integral over the uncovered parts of each edge.

    The integral of x dy - y dx along a straight piece is proportional to the piece's length, so
    only the covered length of each edge is needed.
    """
    order = np.lexsort((first, edge))
    edge, first, last = edge[order], first[order], last[order]
    covered = np.zeros(len(start))
    # Unite the intervals of all edges at once; shifted by 2 per edge they cannot overlap.
    low, high = first + 2.0 * edge, last + 2.0 * edge
    if len(edge):
        reached = np.concatenate([[-1.0], np.maximum.accumulate(high)[:-1]])
        gain = np.maximum(high - np.maximum(low, reached), 0.0)
        np.add.at(covered, edge, gain)
    return float(0.5 * np.sum((1.0 - covered) * _cross(start, end)))
