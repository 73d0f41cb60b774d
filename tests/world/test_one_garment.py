"""One garment for every seed; without one, everything is drawn from the seed as it was."""

import hashlib
import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.planning.flatten_config import FlattenConfig, episode_identity
from clothtrack.recordings.store import read_recording
from clothtrack_lab.world.bench import vary
from clothtrack_lab.world.episodes import EpisodeConfig
from clothtrack_lab.world.filming import simulate
from clothtrack_lab.world.one_garment import OneGarment
from clothtrack_lab.world.simulated_episodes import SimulatedEpisode, knowing_the_garment
from clothtrack_lab.world.simulated_robot import SimulatedRobot, SimulatedRobotConfig
from clothtrack_lab.world.template_mesh import SeededGarment


def digest(value):
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def test_without_a_garment_seed_all_is_drawn_as_before(tmp_path):
    kind = "towel"
    # Kept benchmarks and episodes are known by these settings: another default would disown them.
    settings = asdict(EpisodeConfig())
    # Came later: the lists of before take the defaults.
    assert settings.pop("printed") is False
    assert settings.pop("slips") == 0.0
    assert digest(settings) == "4db02f2ea2903dd6"
    assert set(asdict(SimulatedRobotConfig())) == {
        "episode", "film", "layers", "contact_s", "limits"
    }  # fmt: skip
    assert SimulatedEpisode(kind, 3).label == f"{kind}_0003"
    robot, episode = SimulatedRobot(kind, 3), vary(kind, 3)
    before = SeededGarment(kind, "", episode.size_m, 3).flat(vertex_count=1000)
    flat, _ = robot.true_cloth()
    np.testing.assert_array_equal(flat.vertices, before.vertices)
    np.testing.assert_array_equal(flat.faces, before.faces)
    assert robot.cloth.size_m == episode.size_m
    config = FlattenConfig()
    assert knowing_the_garment(config, None, tmp_path) is config


@pytest.mark.slow
def test_recordings_of_one_garment_differ_in_all_but_the_garment(tmp_path):
    garment = OneGarment("towel", 2)
    sensor = replace(garment.config.sensor, width=160, height=120, focal=125.0)
    action = replace(garment.config.action, frame_rate=10.0)
    small = replace(garment.config, vertex_count=150, actions=1, sensor=sensor, action=action)
    folders = simulate(tmp_path, "towel", 2, seed=7, config=small, garment=garment)
    assert [one.name for one in folders] == ["towel_g0002_0007", "towel_g0002_0008"]
    one, two = map(read_recording, folders)
    assert one.provenance["garment_seed"] == two.provenance["garment_seed"] == 2
    assert one.cloth.size_m == pytest.approx(garment.config.size_m)
    truths = [np.load(tmp_path / "truth" / f"{each.name}.npz") for each in folders]
    for name in ("canonical", "faces", "fabric"):
        np.testing.assert_array_equal(truths[0][name], truths[1][name])
    assert not np.allclose(truths[0]["positions"][0], truths[1]["positions"][0])
    # The first mesh is another triangulation than the world's, and wrong in another way each time.
    for each in (one, two):
        assert len(each.cloth.template.vertices) != len(truths[0]["canonical"])
    assert not np.allclose(one.cloth.template.vertices, two.cloth.template.vertices)
    np.testing.assert_array_equal(one.cloth.template.faces, two.cloth.template.faces)


def test_the_template_of_the_garment_counts_by_its_content(tmp_path):
    config = FlattenConfig(policy="random")
    garments = [OneGarment("tshirt", seed) for seed in (1, 1, 2)]
    known = [
        knowing_the_garment(config, garment, tmp_path / str(number))
        for number, garment in enumerate(garments)
    ]
    paths = {one.perception.template for one in known}
    assert len(paths) == 3
    first, same, other = (episode_identity(one) for one in known)
    assert first == same != other


def test_two_garments_at_once_are_refused_and_nothing_is_written(tmp_path, capsys):
    out = tmp_path / "out"
    for words, told in (
        (["flatten", str(out), "--template", "a.npz"], "leave --template out"),
        (["flatten", str(out), "--recording", "a"], "leave --recording out"),
        (["simulate", str(out), "--template", "a.npz"], "leave template out"),
        (["simulate", str(out), "--states", "3"], "leave --garment-seed out"),
        (["simulate", str(out)], "garment_seed is -1"),
    ):
        seed = "-1" if "-1" in told else "1"
        assert cli.main([*words, "--garment-seed", seed]) in (1, 2)
        assert told in capsys.readouterr().err
    assert not out.exists()
