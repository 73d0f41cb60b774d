"""Pattern pieces: the outline kept, the area filled, no edge where two layers would clash."""

import numpy as np
import pytest

from clothtrack.garments.triangulation import (
    Span,
    triangulate,
)

L_SHAPE = np.array([[0, 0], [0.3, 0], [0.3, 0.1], [0.1, 0.1], [0.1, 0.3], [0, 0.3]], dtype=float)
L_AREA = 0.05


def spans_of(polygon: np.ndarray, sewn: list[bool]) -> list[Span]:
    ends = np.roll(polygon, -1, axis=0)
    return [
        Span(np.array(pair), sewn=flag) for *pair, flag in zip(polygon, ends, sewn, strict=True)
    ]


@pytest.mark.parametrize("seed", range(4))
def test_triangles_fill_the_outline_once(seed: int) -> None:
    piece = triangulate(spans_of(L_SHAPE, [False] * 6), 0.012, seed)
    u, v = (piece.points[piece.faces[:, k]] - piece.points[piece.faces[:, 0]] for k in (1, 2))
    areas = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(L_AREA)
    corner = np.linalg.norm(piece.points[None] - L_SHAPE[:, None], axis=2).min(axis=1)
    assert corner.max() < 1e-12
    equilateral = np.sqrt(3.0) / 4.0 * 0.012**2
    assert np.median(areas) == pytest.approx(equilateral, rel=0.2)


@pytest.mark.parametrize("seed", range(4))
def test_no_inner_edge_joins_two_sewn_vertices(seed: int) -> None:
    flags = [True, False, True, True, False, True]
    piece = triangulate(spans_of(L_SHAPE, flags), 0.03, seed)
    sides = np.sort(piece.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(sides, axis=0, return_counts=True)
    inner = edges[counts == 2]
    assert len(inner) > 20
    assert not piece.sewn[inner].all(axis=1).any()
