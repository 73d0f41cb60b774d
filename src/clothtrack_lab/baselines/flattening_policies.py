"""Flattening policies without a mesh, as baselines for the planner.

Each policy proposes actions for the visible cloth, best first (`planning.flattening.Propose`).
"""

import numpy as np

from clothtrack.planning.action_space import (
    ActionSpace,
    PickPlace,
    SeenCloth,
    edge_measure,
    off_cloth,
    sample_actions,
    within_limits,
)
from clothtrack.planning.flattening import Propose
from clothtrack.planning.planner import PlannerConfig

_RANDOM_TRIES = 20
"""Number of random actions that a robot may refuse in a row before a policy gives up."""


def _random_actions(
    seen: SeenCloth, config: PlannerConfig, rng: np.random.Generator
) -> list[PickPlace]:
    """Return random actions from the planner's action space."""
    return sample_actions(seen, _RANDOM_TRIES, config.space, rng)


def _farthest_off_cloth(
    seen: SeenCloth, config: PlannerConfig, rng: np.random.Generator
) -> list[PickPlace]:
    """Return as many actions as the planner tries, those placed farthest off the cloth first."""
    tried = sample_actions(seen, config.candidates, config.space, rng)
    return [tried[k] for k in np.argsort(-off_cloth(seen, tried), kind="stable")]


def _corner_outwards(
    seen: SeenCloth, config: PlannerConfig, rng: np.random.Generator
) -> list[PickPlace]:
    """Return the action of the geometric heuristic (`farthest_corner`), which is not random."""
    del rng
    action = farthest_corner(seen, config.space)
    return [] if action is None else [action]


POLICIES: dict[str, Propose] = {
    "random": _random_actions,
    "outwards": _farthest_off_cloth,
    "heuristic": _corner_outwards,
}
"""The policies by their names in `FlattenConfig.policy`."""


def farthest_corner(seen: SeenCloth, space: ActionSpace) -> PickPlace | None:
    """Return the action that pulls the corner farthest from the middle straight outwards.

    The pull is as long as allowed. Corners are tried from the farthest on until one can be pulled.
    """
    cloud = seen.cloud
    off = cloud[:, :2] - cloud[:, :2].mean(axis=0)
    far = np.linalg.norm(off, axis=1)
    corner = np.argsort(-far * (edge_measure(cloud) > 0.3), kind="stable")
    for point in corner[:: max(1, len(corner) // 100)]:
        for share in (1.0, 0.75, 0.5, 0.25):
            low, high = space.distance_m
            path = (low + share * (high - low)) * off[point] / max(far[point], 1e-9)
            lift = np.array([0.5 * sum(space.lift_m)])
            pick = cloud[point].astype(np.float64)[None]
            allowed = within_limits(seen, pick, pick[:, :2] + path, lift, space)
            if allowed:
                return allowed[0]
    return None
