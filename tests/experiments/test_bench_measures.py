"""Measures that only the benchmark has: slip of the whole, layers in the wrong order."""

import numpy as np
import pytest
from shared.bench_measures import finite, in_order, swapped_layers, without_slip

from clothtrack.garments.garment_meshes import towel


@pytest.fixture(scope="module")
def flat():
    return towel(0.2, 0.2, spacing_m=0.01)


def folded(flat, gap_m=0.004):
    """The right half over the left half."""
    points = np.array(flat.vertices, np.float64)
    over = points[:, 0] > 0
    points[over, 2] += gap_m
    points[over, 0] *= -1
    return points, over


def test_a_rigid_motion_leaves_no_error(flat):
    points = folded(flat)[0]
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    assert without_slip(points @ turn.T + [0.1, 0.0, 0.02], points) == pytest.approx(0.0, abs=1e-9)


def test_the_truth_has_its_layers_in_order(flat):
    points, _ = folded(flat)
    assert not swapped_layers(points, points, flat).any()
    assert not swapped_layers(flat.vertices.astype(float), flat.vertices.astype(float), flat).any()


def test_a_layer_pushed_through_the_other_is_swapped_where_they_overlap(flat):
    points, over = folded(flat)
    through = points.copy()
    through[over, 2] -= 0.008
    swapped = swapped_layers(through, points, flat)
    # Near the fold the two halves are neighbors in the flat cloth.
    far = np.abs(flat.vertices[:, 0]) > 0.03
    assert swapped[far & over].all()
    assert swapped[far & ~over].all()
    assert not swapped_layers(through + [0.05, 0.0, 0.0], points + [0.05, 0, 0], flat)[~far].all()


def test_order_is_told_wherever_the_layers_lie(flat):
    points, over = folded(flat)
    through = points.copy()
    through[over, 2] -= 0.008
    for away in (0.0, 0.05):
        assert in_order(points + [away, 0.0, 0.0], points, flat) == 1.0
        assert in_order(through + [away, 0.0, 0.0], points, flat) == 0.0
    spread = flat.vertices.astype(float)
    assert in_order(spread, spread, flat) is None


def test_rows_hold_what_json_holds():
    row = {"a": np.float32(np.nan), "b": [np.int64(2), np.inf], "c": {"d": 0.5}}
    assert finite(row) == {"a": None, "b": [2, None], "c": {"d": 0.5}}
