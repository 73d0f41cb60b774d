"""The page of an episode: offline, labelled, and true to what happened."""

import re

import cv2
import numpy as np
import pytest

from clothtrack.planning.dynamics import MotionConfig, SimulatorConfig
from clothtrack.planning.flatten_config import FlattenConfig
from clothtrack.planning.flattening import Step
from clothtrack.planning.perception import PerceptionConfig
from clothtrack.planning.planner import PlannerConfig
from clothtrack.report.flattening_live import watched_live
from clothtrack.report.flattening_page import (
    CONTROL,
    write_film_strip,
    write_flattening_report,
)
from clothtrack.world.episodes import SMALL_WORLD
from clothtrack.world.simulated_episodes import SimulatedEpisode, flatten_simulated
from clothtrack.world.simulated_robot import SimulatedRobotConfig


@pytest.fixture(scope="module")
def watched():
    return []


@pytest.fixture(scope="module")
def store(tmp_path_factory, watched):
    """One action of the control, shown live as it happens."""
    config = FlattenConfig(
        perception=PerceptionConfig(name="truth"),
        simulator=SimulatorConfig(motion=MotionConfig(speed=0.8, rest_s=0.1)),
        planner=PlannerConfig(candidates=8),
        actions=1,
    )
    robot = SimulatedRobotConfig(episode=SMALL_WORLD, film=False)
    with watched_live() as show:

        def watch(step):
            watched.append(step)
            show(step)

        return flatten_simulated(
            tmp_path_factory.mktemp("episode"), SimulatedEpisode("towel", 3), config,
            robot_config=robot, watch=watch,
        )  # fmt: skip


def test_every_step_was_shown(store, watched):
    assert [step.number for step in watched] == [0, 1]
    assert all(isinstance(step, Step) for step in watched)
    assert watched[0].decision.action is not None
    assert watched[1].decision is None


def test_the_page_says_what_it_is_and_asks_nobody(store, tmp_path):
    page = write_flattening_report(store, tmp_path / "page.html").read_text()
    assert page.count(CONTROL) >= 2
    assert "default-src 'none'" in page
    assert not re.search(r"(?:src|href)=\"(?!data:)", page)
    assert page.count("<article") == len(store.steps)
    assert page.count("data:image/jpeg") == 2 * len(store.steps)
    assert "control: truth" in page


def test_the_strip_has_a_picture_per_step_with_arrows(store, tmp_path):
    strip = cv2.imread(str(write_film_strip(store, tmp_path / "strip.png", columns=2)))
    assert strip.shape == (264, 640, 3)
    red = (strip[..., 2] > 180) & (strip[..., 1] < 110) & (strip[..., 0] < 90)
    assert red[:, :320].sum() > 20
    assert np.ptp(strip) > 100
