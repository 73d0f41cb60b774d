"""The closed loop, with a robot of a few lines and with the simulated world."""

import json
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.evaluation.truth import Truth
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.planning.coarse_cloth import CoarseConfig
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
from clothtrack.planning.flattening import EpisodeScene, Flattening, flat_area, improvement
from clothtrack.planning.perception import Estimate, PerceptionConfig
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.planning_dynamics import MotionConfig, SimulatorConfig
from clothtrack.planning.robots.robot import Execution, Reachability, RgbdFrame
from clothtrack.planning.seen import seen_area
from clothtrack.recordings.inspection import inspect
from clothtrack.recordings.recording import ClothDescription, PickerPath, Table
from clothtrack.recordings.store import read_recording
from clothtrack_lab.baselines.flattening_policies import POLICIES
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.simulated_episodes import (
    EpisodeParts,
    SimulatedEpisode,
    flatten_simulated,
)
from clothtrack_lab.world.simulated_robot import SimulatedRobotConfig

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 0.8
CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, POSE)
FLAT = towel(0.2, 0.2, 0.02)
CLOTH = ClothDescription(kind="towel", size_m=(0.2, 0.2))
SMALL = SimulatedRobotConfig(episode=SMALL_WORLD, film=False)


class PaperRobot:
    """Its cloth is stiff paper folded in half, which any action unfolds by a tenth."""

    def __init__(self, fails_at=None):
        self.share, self.clock, self.done = 0.5, count(), 0
        self.fails_at = fails_at

    @property
    def vertices(self):
        return FLAT.vertices * [self.share, 1.0, 1.0] + [0.0, 0.0, 0.01]

    def observe(self):
        drawn = Rasterizer(FLAT.faces, CAMERA).render(self.vertices).depth
        depth = np.where(np.isfinite(drawn), drawn, 0.8).astype(np.float32)
        return RgbdFrame(float(next(self.clock)), CAMERA, depth)

    def check(self, action):
        return Reachability(bool(action.place[1] < 0.2), "too far")

    def execute(self, action):
        assert action.place[1] < 0.2
        if self.done == self.fails_at:
            raise KeyboardInterrupt
        self.share, self.done = self.share + 0.1, self.done + 1
        times = np.array([float(next(self.clock)), float(next(self.clock))])
        frame = replace(self.observe())
        path = PickerPath(times, np.stack([action.pick, action.place]), np.array([True, False]))
        return Execution(path, (frame,), grasped=True)

    def home(self):
        pass


class Known:
    """Perception that knows the paper; a test may."""

    def __init__(self, robot):
        self.robot, self.shown = robot, []

    def perceive(self, recording):
        self.shown.append(recording)
        flat = FLAT.with_vertices(FLAT.vertices + [0.0, 0.0, 0.0015])
        vertices = self.robot.vertices
        return Estimate(flat, vertices, "network", opposite=vertices + [0.0, 0.0, 0.001])


class Stretch:
    """Dynamics in which everything helps."""

    coarse = CoarseConfig()

    def predict(self, cloth, actions):
        scale = [1.0 if one is None else 1.0 + abs(one.place[0]) for one in actions]
        return np.stack([cloth.positions * [one, 1.0, 1.0] for one in scale])


CONFIG = FlattenConfig(planner=PlannerConfig(candidates=20))


def paper(tmp_path, config=CONFIG, robot=None, dynamics=None, progress=None, **options):
    robot = robot or PaperRobot()
    scene = EpisodeScene(CLOTH, TABLE, flat_area(CLOTH))
    parts = {"perception": Known(robot), "dynamics": dynamics or Stretch()}
    flattening = Flattening(robot, scene, config, **parts, **options)
    return robot, flattening.run(tmp_path / "episode", progress=progress)


def test_an_episode_ends_when_the_cloth_is_flat(tmp_path):
    robot, store = paper(tmp_path)
    assert store.document["status"] == "flat"
    assert robot.done == 5
    seen = [row["seen_m2"] / row["flat_m2"] for row in store.steps]
    np.testing.assert_allclose(seen, [0.5, 0.6, 0.7, 0.8, 0.9, 1.0], atol=0.06)
    np.testing.assert_allclose(
        improvement(store.steps, "seen_m2"), np.linspace(0.0, 1.0, 6), atol=0.1
    )


def test_actions_are_counted_and_unreachable_ones_passed_over(tmp_path):
    told = []
    config = replace(CONFIG, actions=2)
    robot, store = paper(tmp_path, config, progress=lambda *words: told.append(words))
    assert store.document["status"] == "all actions are used up"
    assert robot.done == 2
    assert len(store.steps) == 3
    steps = ("look", "plan among 20 candidates", "act")
    said = [f"action {number}/2 at most: {step}" for number in (1, 2) for step in steps]
    said.append("action 2/2 at most: look")
    assert told == [(words, count, 7) for count, words in enumerate(said)]


def test_a_killed_episode_goes_on_where_it_was(tmp_path):
    robot = PaperRobot(fails_at=2)
    with pytest.raises(KeyboardInterrupt):
        paper(tmp_path, robot=robot)
    written = json.loads((tmp_path / "episode" / "episode.json").read_text())
    assert len(written["steps"]) == 3
    # What a kill leaves of a step that was never finished.
    (tmp_path / "episode" / "steps" / "03").mkdir()
    robot.fails_at = None
    _, store = paper(tmp_path, robot=robot)
    assert store.document["status"] == "flat"
    assert robot.done == 5
    untouched, again = paper(tmp_path)
    assert untouched.done == 0
    assert again.steps == store.steps


def test_another_episode_is_not_gone_on_with(tmp_path):
    paper(tmp_path, replace(CONFIG, actions=1))
    with pytest.raises(InvalidConfigError, match=r"another config\.actions \(1, now 3\)"):
        paper(tmp_path, replace(CONFIG, actions=3))
    with pytest.raises(InvalidConfigError, match="another seed"):
        paper(tmp_path, replace(CONFIG, actions=1), seed=5)


def test_an_episode_goes_on_where_nothing_promises_a_gain(tmp_path):
    class Shrink(Stretch):
        def predict(self, cloth, actions):
            same = np.stack([cloth.positions] * len(actions))
            return 2.0 * same - super().predict(cloth, actions)

    robot, store = paper(tmp_path, dynamics=Shrink())
    assert store.document["status"] == "flat"
    assert robot.done == 5
    assert all(step["gain_m2"] < 0.0 for step in store.steps[1:])


def test_the_control_plans_is_labeled_and_leaves_a_normal_recording(tmp_path):
    simulator = SimulatorConfig(motion=MotionConfig(speed=0.8, rest_s=0.1))
    planner = PlannerConfig(candidates=10)
    config = FlattenConfig(
        perception=PerceptionConfig(name="truth"), simulator=simulator, planner=planner, actions=2
    )
    episode = SimulatedEpisode("towel", 3)
    store = flatten_simulated(tmp_path, episode, config, robot_config=SMALL)
    assert store.document["asked"]["label"] == {"perception": "truth", "control": True}
    assert {name for row in store.steps for name in row["sources"]} == {"control: truth"}
    recording = read_recording(tmp_path / "recordings" / "towel_0003")
    assert inspect(recording.folder).valid
    assert len(recording.actions) == len(store.steps) - 1
    assert recording.provenance["control"] is True
    assert recording.cloth.template is None
    truth = Truth.load(tmp_path / "truth" / "towel_0003.npz")
    assert len(truth.positions) == len(store.steps)
    assert truth.frames[-1] == len(recording.frames) - 1
    frame = recording.frames[truth.frames[0]]
    assert seen_area(recording, frame) == pytest.approx(store.steps[0]["true_m2"], rel=0.2)
    starts = list((tmp_path / "starts").iterdir())
    assert len(starts) == 1


@pytest.mark.slow
def test_a_killed_simulated_episode_ends_like_one_that_was_not(tmp_path):
    config = FlattenConfig(policy="heuristic", actions=2)
    # Patches without depth drift from picture to picture: they are to drift on.
    sensor = replace(SMALL_WORLD.sensor, patch_dropout=0.1)
    robot = replace(SMALL, episode=replace(SMALL_WORLD, sensor=sensor))
    parts = EpisodeParts(propose=POLICIES["heuristic"], starts=tmp_path / "starts")
    options = {"robot_config": robot, "parts": parts}
    whole = flatten_simulated(tmp_path / "whole", SimulatedEpisode("towel", 4), config, **options)
    # A policy that needs no mesh is asked without weights, and is no control.
    assert len(whole.steps) == 3
    assert not whole.document["asked"]["label"]["control"]
    assert not list((tmp_path / "whole" / "episodes" / "towel_0004").glob("estimates/*"))

    def stop(store, decision):
        if len(store.document["steps"]) == 2:
            raise KeyboardInterrupt

    broken = tmp_path / "broken"
    with pytest.raises(KeyboardInterrupt):
        flatten_simulated(broken, SimulatedEpisode("towel", 4), config, **options, watch=stop)
    store = flatten_simulated(broken, SimulatedEpisode("towel", 4), config, **options)
    for known in ("true_m2", "seen_m2", "action"):
        assert [row[known] for row in store.steps] == [row[known] for row in whole.steps]
    files = {
        path.relative_to(broken)
        for part in ("recordings", "truth", "worlds")
        for path in (broken / part).rglob("*")
        if path.is_file()
    }
    assert {path.suffix for path in files} == {".png", ".csv", ".json", ".npz"}
    for path in files:
        first, second = ((tmp_path / run / path).read_bytes() for run in ("whole", "broken"))
        assert first == second, path


def test_settings_that_cannot_be_are_refused():
    scene = EpisodeScene(CLOTH, TABLE)
    for config, told in ((FlattenConfig(policy="random"), "policy is random; hand in"),
                         (FlattenConfig(), "planned")):  # fmt: skip
        with pytest.raises(InvalidConfigError, match=told):
            Flattening(PaperRobot(), scene, config, perception=None)
    with pytest.raises(InvalidResultError, match="no such weights"):
        dynamics_of(FlattenConfig(dynamics="mesh", dynamics_weights="nowhere.safetensors"))
    assert flat_area(ClothDescription(kind="other")) is None
