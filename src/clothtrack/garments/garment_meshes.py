"""Flat garments as meshes of any size: a towel and a two-layer T-shirt.

Canonical coordinates do not depend on the triangulation: they identify the same material point in
two meshes of one garment, for any number of vertices.
"""

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.outlines import (
    ShirtOutline,
    TrousersOutline,
    cut_open,
    neckline,
    shirt_spans,
    tshirt_corners,
)
from clothtrack.garments.triangulation import (
    Piece,
    Span,
    distance_to_polyline,
    triangulate,
)
from clothtrack.geometry.mesh import ClothMesh

GarmentKind = Literal["towel", "tshirt"]
"""Garments that are defined by a width and a length."""

ClothKind = Literal["towel", "tshirt", "trousers"]
"""Garments for which states are generated, and that are reconstructed from a picture."""

TowelPattern = Literal["alternating", "regular", "random"]

DEFAULT_SIZES_M: dict[str, tuple[float, float]] = {"towel": (0.3, 0.3), "tshirt": (0.5, 0.45)}
"""Default width and length [m] of each kind of garment."""

TOWEL_SIDES_M = (0.22, 0.34)
"""Range of the sides of generated towels [m]."""

TSHIRT_WIDTHS_M, TSHIRT_LENGTHS_M = (0.42, 0.54), (0.38, 0.48)
"""Ranges of the widths, from sleeve to sleeve, and lengths of generated T-shirts [m]."""

_SAME_M = 1e-9
"""Corners of two pieces that are nearer than this [m] are one."""

_SEAM_TAPER_M = 0.02
"""Distance [m] from a seam over which the two layers of a flat garment reach their full gap."""


def towel(
    width_m: float = 0.3,
    length_m: float = 0.3,
    spacing_m: float = 0.01,
    *,
    pattern: TowelPattern = "alternating",
    seed: int = 0,
) -> ClothMesh:
    """Make a rectangle in the plane z = 0, centered at the origin.

    Args:
        width_m: extent along x [m].
        length_m: extent along y [m].
        spacing_m: length of an edge [m]; each side gets the nearest whole number of edges.
    """
    _check_size(width_m, length_m, spacing_m)
    if pattern == "random":
        x, y = width_m / 2.0, length_m / 2.0
        corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y], [-x, -y]])
        spans = [Span(corners[k : k + 2]) for k in range(4)]
        piece = triangulate(spans, spacing_m, seed)
        points, faces = piece.points, piece.faces
    else:
        columns, rows = (max(1, round(size / spacing_m)) for size in (width_m, length_m))
        grid_x, grid_y = np.meshgrid(
            np.linspace(-0.5, 0.5, columns + 1) * width_m,
            np.linspace(-0.5, 0.5, rows + 1) * length_m,
        )
        points = np.stack([grid_x.ravel(), grid_y.ravel()], axis=1)
        index = np.arange(len(points), dtype=np.int32).reshape(rows + 1, columns + 1)
        a, b = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
        d, c = index[1:, :-1].ravel(), index[1:, 1:].ravel()
        rising = np.stack([a, b, c, a, c, d], axis=1)
        falling = np.stack([a, b, d, b, c, d], axis=1)
        row, column = np.divmod(np.arange(len(a)), columns)
        odd = ((row + column) % 2 == 1) & (pattern == "alternating")
        faces = np.where(odd[:, None], falling, rising).reshape(-1, 3)
    vertices = np.column_stack([points, np.zeros(len(points))])
    return ClothMesh(vertices, faces, vertices.copy())


def tshirt(
    width_m: float = 0.5,
    length_m: float = 0.45,
    spacing_m: float = 0.01,
    *,
    layer_gap_m: float = 0.004,
    seed: int = 0,
) -> ClothMesh:
    """Make a flat T-shirt: front layer above the back layer, sewn at shoulders and sides.

    Hem, cuffs and neck are open; the neck is cut deeper in front. The T-shirt lies around z = 0,
    centered at the origin, neck toward +y. Canonical coordinates are the flat (x, y) and an
    inflated height that is positive on the front, negative on the back and zero on the seams.

    Args:
        width_m: width from cuff to cuff [m].
        length_m: length from hem to shoulder [m].
        spacing_m: length of an edge [m].
        layer_gap_m: distance of the layers [m] away from the seams.
    """
    _check_size(width_m, length_m, spacing_m)
    corners = tshirt_corners(width_m, length_m)
    front, back = (
        shirt_spans(corners, neckline(corners, depth * length_m)) for depth in (0.10, 0.03)
    )
    return two_layers(front, back, spacing_m, layer_gap_m=layer_gap_m, seed=seed)


def two_layers(
    front: list[Span],
    back: list[Span],
    spacing_m: float,
    *,
    layer_gap_m: float = 0.004,
    open_front: bool = False,
    hood: list[Span] | None = None,
    seed: int = 0,
) -> ClothMesh:
    """Make a garment of a front on a back that are sewn together at the seams of both outlines.

    Canonical coordinates are the flat (x, y) and an inflated height that is positive on the front,
    negative on the back and zero on the seams.

    Args:
        front: outline [m] of the front, counterclockwise; open edges may differ from the back's.
        spacing_m: length of an edge [m].
        layer_gap_m: distance of the layers [m] away from the seams.
    """
    behind = triangulate(back, spacing_m, 2 * seed + 1)
    outlines = [*(cut_open(front) if open_front else [front]), *([hood] if hood else [])]
    ahead = _side_by_side([triangulate(one, spacing_m, 2 * seed) for one in outlines])
    points, faces, side = _sewn_together(ahead, behind)
    seams = [span.points for span in [*front, *(hood or [])] if span.sewn]
    from_seam = np.min([distance_to_polyline(points, seam) for seam in seams], axis=0)
    gap = 0.5 * layer_gap_m * _rounded(from_seam / _SEAM_TAPER_M)
    width_m = float(np.ptp(points[:, 0]))
    inflated = 0.12 * width_m * _rounded(from_seam / (0.25 * width_m))
    return ClothMesh(
        np.column_stack([points, side * gap]), faces, np.column_stack([points, side * inflated])
    )


def shirt(
    outline: ShirtOutline,
    length_m: float,
    *,
    vertex_count: int = 1000,
    open_front: bool = False,
    seed: int = 0,
) -> ClothMesh:
    """Make a shirt of any cut, lying flat like `tshirt`.

    Args:
        length_m: length from the hem to the neck [m].
    """
    front = outline.spans(length_m, depth=outline.front_depth)
    if outline.hood:
        back, hood = outline.hooded_back(length_m), outline.hood_front(length_m)
    else:
        back, hood = outline.spans(length_m, depth=outline.back_depth), None
    return sewn(front, back, vertex_count=vertex_count, open_front=open_front, hood=hood, seed=seed)


def trousers(
    outline: TrousersOutline, length_m: float, *, vertex_count: int = 1000, seed: int = 0
) -> ClothMesh:
    """Make trousers of any cut, lying flat, waist toward +y; waist and two cuffs are open.

    Args:
        length_m: length from the cuffs to the waist [m].
    """
    spans = outline.spans(length_m)
    return sewn(spans, spans, vertex_count=vertex_count, seed=seed)


def sewn(
    front: list[Span],
    back: list[Span],
    *,
    vertex_count: int = 1000,
    open_front: bool = False,
    hood: list[Span] | None = None,
    seed: int = 0,
) -> ClothMesh:
    """Make a garment of two layers (`two_layers`) with about the desired number of vertices."""
    return with_vertices(
        lambda edge_m: two_layers(front, back, edge_m, open_front=open_front, hood=hood, seed=seed),
        vertex_count,
        _edge_for(vertex_count, front, layers=2),
    )


def one_layer(spans: list[Span], *, vertex_count: int = 1000, seed: int = 0) -> ClothMesh:
    """Make a cloth of one layer in the plane z = 0 from its counterclockwise outline [m]."""

    def cut(edge_m: float) -> ClothMesh:
        piece = triangulate(spans, edge_m, seed)
        vertices = np.column_stack([piece.points, np.zeros(len(piece.points))])
        return ClothMesh(vertices, piece.faces, vertices.copy())

    return with_vertices(cut, vertex_count, _edge_for(vertex_count, spans, layers=1))


def _edge_for(vertex_count: int, spans: list[Span], *, layers: int) -> float:
    """Return the length of an edge [m] for which the layers have this many vertices."""
    x, y = np.concatenate([span.points[:-1] for span in spans]).T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    # A lattice of equilateral triangles has one vertex per sqrt(3)/2 of a squared edge.
    return math.sqrt(2.0 * layers / math.sqrt(3.0) * area / vertex_count)


def garment(
    kind: str,
    *,
    vertex_count: int = 1000,
    size_m: tuple[float, float] | None = None,
    pattern: TowelPattern = "alternating",
    seed: int = 0,
) -> ClothMesh:
    """Make a flat garment with about the desired number of vertices (within about 8 %).

    Args:
        size_m: width and length [m]; None: the default size of the kind.
    """
    if kind not in DEFAULT_SIZES_M:
        raise InvalidConfigError(
            f"kind is {kind!r}; known garments are {', '.join(DEFAULT_SIZES_M)}"
        )
    width, length = size_m or DEFAULT_SIZES_M[kind]
    is_towel = kind == "towel"

    def make(spacing: float) -> ClothMesh:
        if is_towel:
            return towel(width, length, spacing, pattern=pattern, seed=seed)
        return tshirt(width, length, spacing, seed=seed)

    layers = 1.0 if is_towel else 1.2
    return with_vertices(make, vertex_count, float(np.sqrt(layers * width * length / vertex_count)))


def with_vertices(
    make: Callable[[float], ClothMesh], vertex_count: int, spacing: float
) -> ClothMesh:
    """Return the mesh whose number of vertices is nearest to the desired one.

    Args:
        make: makes a mesh with edges of a given length [m].
        spacing: initial length of an edge [m].
    """
    best = make(spacing)
    for _ in range(6):
        candidate = make(spacing)
        if abs(candidate.vertex_count - vertex_count) < abs(best.vertex_count - vertex_count):
            best = candidate
        if abs(candidate.vertex_count / vertex_count - 1.0) < 0.02:
            break
        spacing *= float(np.sqrt(candidate.vertex_count / vertex_count))
    return best


def _check_size(width_m: float, length_m: float, spacing_m: float) -> None:
    if not 0.0 < spacing_m <= min(width_m, length_m) / 4.0:
        raise InvalidConfigError(
            f"spacing_m is {spacing_m:.4g} for a garment of {width_m:.4g} m x {length_m:.4g} m; "
            f"it must be above 0 and at most a quarter of the shorter side"
        )


def _rounded(share: Float[np.ndarray, " vertices"]) -> Float[np.ndarray, " vertices"]:
    """Return a quarter-circle profile: 0 at 0 with a vertical tangent, constant from 1 on."""
    rest = 1.0 - np.minimum(share, 1.0)
    return np.sqrt(1.0 - rest**2)


def _side_by_side(pieces: list[Piece]) -> Piece:
    """Return several pieces of one layer as one piece, joined only where the same seam ends."""
    first = np.cumsum([0] + [len(piece.points) for piece in pieces[:-1]])
    points = np.concatenate([piece.points for piece in pieces])
    faces = np.concatenate(
        [piece.faces + start for piece, start in zip(pieces, first, strict=True)]
    )
    sewn = np.concatenate([piece.sewn for piece in pieces])
    # A neck's end belongs to the front and to the hood.
    same = np.arange(len(points))
    for one, other in cKDTree(points[sewn]).query_pairs(_SAME_M):
        same[np.flatnonzero(sewn)[other]] = np.flatnonzero(sewn)[one]
    kept = same == np.arange(len(points))
    index = (np.cumsum(kept) - 1)[same].astype(np.int32)
    return Piece(points[kept], index[faces], sewn[kept])


def _sewn_together(
    front: Piece, back: Piece
) -> tuple[
    Float[np.ndarray, "vertices 2"], Int[np.ndarray, "faces 3"], Float[np.ndarray, " vertices"]
]:
    """Join two pieces at their sewn vertices, which have the same positions.

    Returns the points [m], the faces (outward on both layers) and the side of each vertex:
    +1 front, -1 back, 0 on a seam.
    """
    own = np.flatnonzero(~back.sewn)
    index = np.empty(len(back.points), dtype=np.int32)
    _, same = cKDTree(front.points[front.sewn]).query(back.points[back.sewn])
    index[back.sewn] = np.flatnonzero(front.sewn)[same]
    index[own] = len(front.points) + np.arange(len(own))
    points = np.concatenate([front.points, back.points[own]])
    faces = np.concatenate([front.faces, index[back.faces][:, ::-1]]).astype(np.int32)
    side = np.concatenate([np.where(front.sewn, 0.0, 1.0), np.full(len(own), -1.0)])
    return points, faces, side
