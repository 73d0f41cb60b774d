"""The page of an episode: offline, labeled, and true to what happened."""

import json
import re
import urllib.request

import pytest

from clothtrack.planning.flatten_config import FlattenConfig
from clothtrack.planning.perception import PerceptionConfig
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.planning_dynamics import MotionConfig, SimulatorConfig
from clothtrack.report.flattening_page import (
    CONTROL,
    watched_live,
    write_flattening_report,
)
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.simulated_episodes import SimulatedEpisode, flatten_simulated
from clothtrack_lab.world.simulated_robot import SimulatedRobotConfig


@pytest.fixture(scope="module")
def shown():
    """The pages that were served, and what was decided."""
    return []


def get(address, path):
    with urllib.request.urlopen(address + path, timeout=10) as answer:
        return answer.read().decode()


@pytest.fixture(scope="module")
def store(tmp_path_factory, shown):
    """One action of the control, shown live as it happens."""
    config = FlattenConfig(
        perception=PerceptionConfig(name="truth"),
        simulator=SimulatorConfig(motion=MotionConfig(speed=0.8, rest_s=0.1)),
        planner=PlannerConfig(candidates=8),
        actions=1,
    )
    robot = SimulatedRobotConfig(episode=SMALL_WORLD, film=False)
    addresses = []
    with watched_live(opened=addresses.append) as show:

        def watch(store, decision):
            show(store, decision)
            version = json.loads(get(addresses[0], "version"))["version"]
            shown.append((version, get(addresses[0], ""), decision))

        return flatten_simulated(
            tmp_path_factory.mktemp("episode"), SimulatedEpisode("towel", 3), config,
            robot_config=robot, watch=watch,
        )  # fmt: skip


def test_every_step_was_served_as_it_came(store, shown):
    (first, before, action), (last, after, nothing) = shown
    assert (first, last) == (1, 2)
    assert before.count("<article") == 1
    assert after.count("<article") == len(store.steps) == 2
    assert action.action is not None
    assert nothing is None
    assert "0 actions; running" in before
    assert "1 actions; ended: " in after
    assert 'data-version="2"' in after


def test_the_page_says_what_it_is_and_asks_nobody(store, tmp_path):
    page = write_flattening_report(store, tmp_path / "page.html").read_text()
    assert page.count(CONTROL) >= 2
    assert "default-src 'none'" in page
    assert not re.search(r"(?:src|href)=\"(?!data:)", page)
    assert page.count("<article") == len(store.steps)
    assert page.count("data:image/jpeg") == 2 * len(store.steps)
    assert "control: truth" in page
