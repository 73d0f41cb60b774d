"""The verbs that act."""

import json

import pytest

from clothtrack.cli import command_line as cli
from clothtrack_lab.cli.act import train_dynamics

QUICK = [
    "--set", "simulator.motion.speed=0.8", "--set", "simulator.motion.rest_s=0.1",
    "--set", "planner.candidates=8",
]  # fmt: skip


@pytest.mark.slow
def test_the_control_is_labelled_on_the_command_line(tmp_path, capsys):
    words = ["flatten", str(tmp_path), "--perception", "truth", "--actions", "1", *QUICK]
    assert cli.main(words) == 0
    assert "CONTROL" in capsys.readouterr().out
    assert (tmp_path / "towel_0000.html").exists()
    assert cli.main([*words, "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["control"] is True
    assert len(told["improvement"]) == told["actions"] + 1


def test_wishes_that_exclude_each_other_are_usage_errors(tmp_path, capsys):
    out = str(tmp_path / "out")
    assert cli.main(["flatten", out, "--robot", "dry-run", "--policy", "random"]) == 2
    assert "--recording" in capsys.readouterr().err
    words = ["flatten", out, "--policy", "random", "--recording", str(tmp_path)]
    assert cli.main(words) == 2
    assert cli.main(["flatten", out, "--weights", str(tmp_path / "none.safetensors")]) == 1
    assert "no such weights" in capsys.readouterr().err
    assert cli.main(["flatten", out, "--policy", "random", "--set", "actions=0"]) == 1
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_read_is_refused_before_a_start_is_made(tmp_path, monkeypatch, capsys):
    weights = "clothtrack.reconstruction.model_loading.shipped_weights"
    monkeypatch.setattr(weights, lambda kind: None)
    bad = tmp_path / "bad.safetensors"
    bad.write_bytes(b"not weights")
    out = tmp_path / "out"
    for words, told in (
        ([], "no weights for 'towel'"),
        (["--weights", str(bad)], "not a whole safetensors file"),
        (["--set", f"perception.weights={tmp_path / 'none'}"], "no such weights"),
        (
            ["--perception", "truth", "--dynamics", "mesh", "--dynamics-weights", str(bad)],
            "not a whole safetensors file",
        ),
        (["--perception", "truth", "--episodes", "0"], "--episodes is 0"),
        (["--robot", "dry-run", "--recording", str(tmp_path), "--policy", "random"], "recording"),
    ):
        assert cli.main(["flatten", str(out), *words]) == 1
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert told in line
    assert not out.exists()


def test_a_picture_without_cloth_is_refused_before_a_dry_run_begins(tmp_path, capsys):
    from clothtrack.recordings.pictures import read_depth
    from clothtrack.recordings.store import read_recording
    from clothtrack_lab.world.episodes import SMALL_WORLD
    from clothtrack_lab.world.filming import simulate

    (folder,) = simulate(tmp_path / "world", "towel", 1, config=SMALL_WORLD)
    frame = read_recording(folder).frames[-1]
    (path,) = frame.depth.values()
    assert read_depth(path, 0.001).any()
    path.write_bytes(b"no picture")
    words = ["flatten", str(tmp_path / "plan"), "--robot", "dry-run", "--policy", "heuristic"]
    assert cli.main([*words, "--recording", str(folder)]) == 1
    assert path.name in capsys.readouterr().err
    assert not (tmp_path / "plan").exists()


def test_a_dry_run_without_a_mesh_needs_a_recording_only(tmp_path, capsys):
    from clothtrack_lab.world.episodes import SMALL_WORLD
    from clothtrack_lab.world.filming import simulate

    (recording,) = simulate(tmp_path / "world", "towel", 1, config=SMALL_WORLD)
    words = ["flatten", str(tmp_path / "plan"), "--robot", "dry-run", "--policy", "heuristic"]
    assert cli.main([*words, "--recording", str(recording)]) == 0
    assert "action_00.png" in capsys.readouterr().out
    told = json.loads((tmp_path / "plan" / "action_00.json").read_text())
    assert len(told["waypoints"]) == 6


def test_the_truth_is_not_to_be_had_in_a_dry_run(tmp_path, capsys):
    from clothtrack_lab.world.episodes import SMALL_WORLD
    from clothtrack_lab.world.filming import simulate

    (recording,) = simulate(tmp_path / "world", "towel", 1, config=SMALL_WORLD)
    words = ["flatten", str(tmp_path / "plan"), "--robot", "dry-run", "--perception", "truth"]
    assert cli.main([*words, "--recording", str(recording)]) == 1
    assert "only the simulated robot" in capsys.readouterr().err


@pytest.mark.slow
def test_dynamics_are_made_and_trained_by_one_command(tmp_path, capsys):
    settings = (
        "roll_outs.vertex_count=150", "roll_outs.starts=1", "roll_outs.actions=3",
        "roll_outs.motion.speed=0.8", "roll_outs.states.crumpling.states=1",
        "network.width=16", "network.message_steps=2", "loop.epochs=1", "examples_per_shard=2",
        "loop.held_out_share=0.4",
    )  # fmt: skip
    asked = {"garment": ("towel", "tshirt"), "roll_outs": 3, "settings": settings}
    assert train_dynamics(tmp_path, **asked) == 0
    told = capsys.readouterr().out
    assert "best.safetensors" in told
    assert len(list((tmp_path / "roll_outs").glob("*/shards/*.npz"))) == 2
    card = (tmp_path / "model" / "model_card.md").read_text()
    assert "towel, tshirt" in card
    assert "whole error mm" in card
