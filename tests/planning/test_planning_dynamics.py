"""The simulator as dynamics of a planner: candidates do not know of each other."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.planning_dynamics import (
    PlannedCloth,
    SimulatorDynamics,
    held_vertex,
)

FLAT = towel(0.2, 0.2, 0.025)
LYING = PlannedCloth(FLAT, FLAT.vertices + [0.0, 0.0, 0.0015])
CORNER = np.array([0.1, 0.1, 0.0015])
INWARDS = PickPlace(CORNER, np.array([-0.03, -0.03, 0.01]), 0.06)
ASIDE = PickPlace(CORNER, np.array([0.15, 0.1, 0.006]), 0.03)
MISSED = PickPlace(np.array([0.3, 0.3, 0.0]), np.array([0.1, 0.1, 0.0]), 0.03)


@pytest.fixture(scope="module")
def dynamics():
    return SimulatorDynamics()


def test_doing_nothing_and_missing_leave_a_flat_cloth_flat(dynamics):
    nothing, missed = dynamics.predict(LYING, [None, MISSED])
    np.testing.assert_allclose(nothing, LYING.positions, atol=1e-3)
    np.testing.assert_array_equal(nothing, missed)


def test_a_corner_carried_inwards_folds_the_cloth_and_lies_where_it_was_put(dynamics):
    (folded,) = dynamics.predict(LYING, [INWARDS])
    corner = held_vertex(LYING, INWARDS)
    np.testing.assert_allclose(folded[corner, :2], INWARDS.place[:2], atol=0.02)
    area = projected_area(folded, FLAT.faces)
    # A triangle of this height is folded over, (0.13 sqrt(2) / 2) ** 2, and the rest slides.
    assert area == pytest.approx(0.04 - 0.5 * 0.13**2, rel=0.12)


def test_a_candidate_is_the_same_alone_and_among_others(dynamics):
    together = dynamics.predict(LYING, [INWARDS, None, ASIDE])
    alone = dynamics.predict(LYING, [ASIDE])
    # Held no longer than its own way takes: others may still be under way.
    np.testing.assert_allclose(together[2], alone[0], atol=2e-3)
    again = dynamics.predict(LYING, [INWARDS, None, ASIDE])
    np.testing.assert_array_equal(again, together)


def test_the_topmost_vertex_under_the_pick_is_held():
    folded = FLAT.vertices.copy()
    over = folded[:, 0] > 0.0
    folded[over] = folded[over] * [-1.0, 1.0, 1.0] + [0.0, 0.0, 0.01]
    cloth = PlannedCloth(FLAT, folded)
    vertex = held_vertex(cloth, PickPlace(np.array([-0.05, 0.05, 0.01]), CORNER, 0.05))
    assert over[vertex]
    assert held_vertex(cloth, MISSED) is None


def test_batches_of_candidates_that_last_alike_change_nothing_but_the_wait(dynamics):
    asked = [INWARDS, None, ASIDE, MISSED]
    apart = SimulatorDynamics(together=1).predict(LYING, asked)
    np.testing.assert_allclose(apart, dynamics.predict(LYING, asked), atol=2e-3)
