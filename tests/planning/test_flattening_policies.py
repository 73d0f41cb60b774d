"""The policies without a mesh propose what their names say, within the limits."""

from dataclasses import replace

import numpy as np

from clothtrack.planning.action_space import ActionSpace, SeenCloth, Workspace, off_cloth
from clothtrack.planning.planner import PlannerConfig
from clothtrack_lab.flattening import POLICIES, farthest_corner


def sheet():
    """A sheet of 0.2 by 0.2 m about the origin, seen from everywhere."""
    x, y = np.meshgrid(np.arange(-0.1, 0.1, 0.004), np.arange(-0.1, 0.1, 0.004))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.002)])


SEEN = SeenCloth(sheet(), None)


def test_the_heuristic_pulls_a_corner_outwards():
    action = farthest_corner(SEEN, ActionSpace())
    assert np.abs(action.pick[:2]).min() > 0.08
    assert np.linalg.norm(action.place[:2]) > np.linalg.norm(action.pick[:2]) + 0.04
    assert (action.place - action.pick)[:2] @ action.pick[:2] > 0.0


def test_no_corner_is_picked_below_the_table_however_noisy_the_cloud_is(rng):
    noisy = SEEN.cloud.copy()
    noisy[:, 2] += rng.normal(scale=0.004, size=len(noisy))
    action = farthest_corner(replace(SEEN, cloud=noisy), ActionSpace())
    assert action.pick[2] >= SEEN.table_height_m


def test_outwards_proposes_the_place_farthest_off_the_cloth_first(rng):
    proposed = POLICIES["outwards"](SEEN, PlannerConfig(candidates=30), rng)
    assert len(proposed) == 30
    assert (np.diff(off_cloth(SEEN, proposed)) <= 0.0).all()


def test_nothing_in_reach_is_no_proposal(rng):
    space = ActionSpace(workspace=Workspace(x_m=(1.0, 2.0)))
    for propose in POLICIES.values():
        assert list(propose(SEEN, PlannerConfig(space=space), rng)) == []
