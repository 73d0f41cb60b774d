"""Roll-outs and a network small enough for tests."""

from dataclasses import replace

import pytest

from clothtrack.planning.coarse_cloth import CoarseConfig
from clothtrack.planning.planning_dynamics import MotionConfig
from clothtrack.reconstruction.data.recipes import CrumplingConfig
from clothtrack.reconstruction.data.states import StatesConfig
from clothtrack_lab.graph_dynamics.roll_outs import RollOutConfig, generate_roll_outs

SMALL_ROLL_OUTS = RollOutConfig(
    vertex_count=150,
    starts=1,
    actions=4,
    coarse=CoarseConfig(spacing_m=0.035),
    motion=MotionConfig(speed=0.8, rest_s=0.1),
    states=replace(StatesConfig(), crumpling=CrumplingConfig(states=1, rest_limit_s=0.2)),
)


@pytest.fixture(scope="session")
def roll_outs(tmp_path_factory):
    """Three shards of a towel."""
    folder = tmp_path_factory.mktemp("roll_outs")
    return generate_roll_outs(folder, "towel", 12, config=SMALL_ROLL_OUTS)


@pytest.fixture
def small_roll_outs():
    """How they are made."""
    return SMALL_ROLL_OUTS
