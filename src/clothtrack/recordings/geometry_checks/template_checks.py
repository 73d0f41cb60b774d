"""Checks of the template, which must be one surface, and of the size, which must be plausible."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.recording import Recording

_WELD_M = 0.0005
"""Boundary vertices nearer than this [m] to one of another triangle are one vertex, written twice:
layers of a template are at least 1 mm apart, and edges are 5 mm long."""

_MOST_DOUBLE = 0.02
"""Largest share of the vertices that may be double; a seam that was left open has less."""

_MOST_SLIVERS = 0.02
"""Largest share of the triangles without area, or with a height of less than 1 % of their longest
side; the solver's bending has no meaning there."""

_LEAST_PIECE = 0.02
"""A piece with less than this share of the vertices is a speck; two larger ones are two cloths."""

_PLAUSIBLE_M = {
    "towel": (0.08, 2.2),
    "tshirt": (0.25, 1.2),
    "trousers": (0.25, 1.4),
}
"""Least and greatest plausible longer side of a flat garment [m]: from a coaster to a bath sheet,
from a baby's shirt to 5XL with its sleeves spread, from a baby's trousers to the longest sold."""

_LEAST_ASPECT = 0.2
"""Least shorter side, as a share of the longer one; it is 0.25 for trousers laid leg on leg."""


def template_findings(recording: Recording) -> list[Finding]:
    """Return why the template is not the surface of a cloth: at most one finding."""
    template = recording.cloth.template
    if template is None:
        return []
    for check in (_double, _pieces, _slivers):
        if found := check(template):
            return [found]
    return []


def size_findings(recording: Recording) -> list[Finding]:
    """Return a size that no garment of this kind has."""
    size, kind = recording.cloth.size_m, recording.cloth.kind
    if size is None or kind not in _PLAUSIBLE_M:
        return []
    low, high = _PLAUSIBLE_M[kind]
    longer, shorter = max(size), min(size)
    plausible = low <= longer <= high and shorter >= _LEAST_ASPECT * longer
    if plausible:
        return []
    return [
        Finding(
            "size_implausible", longer, high if longer > high else low, "m", "cloth.size_m",
            f"cloth.size_m is {size[0]:g} x {size[1]:g} m; a {kind}'s longer side is {low:g} to "
            f"{high:g} m, the other at least {100 * _LEAST_ASPECT:.0f} % of it: give its flat "
            "width and length in meters, or another cloth.kind",
        )
    ]  # fmt: skip


def _finding(measured: float, limit: float, shown: str) -> Finding:
    return Finding(
        "template_surface", measured, limit, "", "cloth.template",
        f"cloth.template is no surface of one cloth, {shown}: weld and repair it in a mesh editor "
        "(MeshLab: merge close vertices, remove duplicate faces), or leave it out",
    )  # fmt: skip


def _double(template: ClothMesh) -> Finding | None:
    """Return a finding for boundary vertices in the same place, whose triangles are not joined."""
    counts, edges = _edge_counts(template)
    rim = np.unique(edges[counts == 1])
    if not len(rim):
        return None
    pairs = cKDTree(template.vertices[rim]).query_pairs(_WELD_M, output_type="ndarray")
    share = len(np.unique(pairs)) / len(template.vertices)
    if share <= _MOST_DOUBLE:
        return None
    return _finding(
        share, _MOST_DOUBLE, f"{100 * share:.0f} % of its vertices have a double within "
        f"{1e3 * _WELD_M:g} mm (at most {100 * _MOST_DOUBLE:.0f} %), so its triangles are not "
        f"joined",
    )  # fmt: skip


def _pieces(template: ClothMesh) -> Finding | None:
    _, edges = _edge_counts(template)
    count = len(template.vertices)
    links = coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count))
    _, piece = connected_components(links, directed=False)
    large = int((np.bincount(piece) >= _LEAST_PIECE * count).sum())
    return _finding(float(large), 1.0, f"it has {large} separate pieces (1)") if large > 1 else None


def _slivers(template: ClothMesh) -> Finding | None:
    a, b, c = (template.vertices[corner] for corner in template.faces.T)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-12)
    share = float((height < 0.01 * np.maximum(longest, 1e-9)).mean())
    if share <= _MOST_SLIVERS:
        return None
    return _finding(
        share, _MOST_SLIVERS, f"{100 * share:.0f} % of its triangles have hardly any area (at most "
        f"{100 * _MOST_SLIVERS:.0f} %)",
    )  # fmt: skip


def _edge_counts(template: ClothMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return how many triangles have each edge, and the edges."""
    faces = template.faces
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    return counts, unique
