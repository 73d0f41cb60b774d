"""Bending of a template, relative to a flat sheet, as rows of a linear system."""

import numpy as np
from jaxtyping import Bool
from scipy import sparse

from clothtrack.geometry.mesh import ClothMesh


def smoothness_matrix(template: ClothMesh) -> sparse.csr_array:
    """Return rows that are zero for any flat sheet: a vertex minus the mean of its neighbors.

    The cotangents of the flat mesh weight the neighbors (U. Pinkall, K. Polthier, 1993), so that
    the rows are zero for an irregular mesh too. The rows of rims and seams are empty because a flat
    shirt folds back there.
    """
    corners = template.vertices[template.faces]
    count = template.vertex_count
    rows, columns, weights = [], [], []
    for k in range(3):
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        area = np.linalg.norm(np.cross(a, b), axis=1)
        half = 0.5 * np.einsum("fi,fi->f", a, b) / np.maximum(area, 1e-12)
        i, j = template.faces[:, (k + 1) % 3], template.faces[:, (k + 2) % 3]
        rows += [i, j]
        columns += [j, i]
        weights += [half, half]
    joined = sparse.coo_array(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (count, count)
    ).tocsr()
    total = joined.sum(axis=1)
    inside = ~(_on_rim(template) | _on_seam(template)) & (total > 1e-6)
    share = sparse.diags_array(np.where(inside, 1.0 / np.where(inside, total, 1.0), 0.0))
    return (sparse.diags_array(inside.astype(np.float64)) - share @ joined).tocsr()


def _on_rim(template: ClothMesh) -> Bool[np.ndarray, " vertices"]:
    sides = np.sort(template.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(sides, axis=0, return_counts=True)
    found = np.zeros(template.vertex_count, dtype=bool)
    found[edges[counts == 1]] = True
    return found


def _on_seam(template: ClothMesh) -> Bool[np.ndarray, " vertices"]:
    """Return vertices where the layers of an inflated garment meet."""
    if template.canonical is None or not np.ptp(template.canonical[:, 2]) > 0:
        return np.zeros(template.vertex_count, dtype=bool)
    return np.abs(template.canonical[:, 2]) < 1e-6
