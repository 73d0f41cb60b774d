"""Flattening: planning of pick-and-places, their predicted result, and their execution."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.planning.action_space import ActionSpace, PickPlace, SeenCloth, Workspace
    from clothtrack.planning.coarse_cloth import CoarseConfig
    from clothtrack.planning.episode_store import EpisodeStore
    from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
    from clothtrack.planning.flattening import EpisodeScene, Flattening, flat_area, improvement
    from clothtrack.planning.perception import Estimate, PerceptionConfig, perception_of
    from clothtrack.planning.planner import Hypothesis, Planner, PlannerConfig
    from clothtrack.planning.planning_dynamics import (
        PlannedCloth,
        PlanningDynamics,
        SimulatorConfig,
        SimulatorDynamics,
    )
    from clothtrack.planning.reward import coverage
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "ActionSpace",
    "CoarseConfig",
    "EpisodeScene",
    "EpisodeStore",
    "Estimate",
    "FlattenConfig",
    "Flattening",
    "Hypothesis",
    "PerceptionConfig",
    "PickPlace",
    "PlannedCloth",
    "Planner",
    "PlannerConfig",
    "PlanningDynamics",
    "SeenCloth",
    "SimulatorConfig",
    "SimulatorDynamics",
    "Workspace",
    "coverage",
    "dynamics_of",
    "flat_area",
    "improvement",
    "perception_of",
]
