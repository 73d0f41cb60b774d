"""The verbs that act."""

import json
import shutil

import pytest

import clothtrack_lab as lab
from clothtrack.cli import command_line as cli

QUICK = [
    "--set", "simulator.motion.speed=0.8", "--set", "simulator.motion.rest_s=0.1",
    "--set", "planner.candidates=8",
]  # fmt: skip


@pytest.mark.slow
def test_the_control_is_labeled_on_the_command_line(tmp_path, capsys):
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
    words = ["flatten", out, "--garment-seed", "1", "--recording", str(tmp_path)]
    assert cli.main(words) == 2
    assert "leave --recording out" in capsys.readouterr().err
    assert cli.main(["flatten", out, "--policy", "random", "--live", "--workers", "2"]) == 2
    assert "--live shows one process" in capsys.readouterr().err
    assert cli.main(["flatten", out, "--weights", str(tmp_path / "none.safetensors")]) == 1
    assert "no such weights" in capsys.readouterr().err
    assert cli.main(["flatten", out, "--policy", "random", "--set", "actions=0"]) == 1
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_read_is_refused_before_a_start_is_made(tmp_path, monkeypatch, capsys):
    weights = "clothtrack.reconstruction.model_loading.shipped_weights"
    monkeypatch.setattr(weights, lambda: None)
    bad = tmp_path / "bad.safetensors"
    bad.write_bytes(b"not weights")
    out = tmp_path / "out"
    for words, told in (
        ([], "no weights come with"),
        (["--weights", str(bad)], "not a whole safetensors file"),
        (["--set", f"perception.weights={tmp_path / 'none'}"], "no such weights"),
        (
            ["--perception", "truth", "--dynamics", "mesh", "--dynamics-weights", str(bad)],
            "not a whole safetensors file",
        ),
        (["--perception", "truth", "--episodes", "0"], "--episodes is 0"),
        (["--recording", str(tmp_path), "--policy", "random"], "recording"),
    ):
        assert cli.main(["flatten", str(out), *words]) == 1
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert told in line
    assert not out.exists()


def test_a_picture_without_cloth_is_refused_before_a_dry_run_begins(napkin, tmp_path, capsys):
    from clothtrack.recordings.pictures import read_depth
    from clothtrack.recordings.store import read_recording

    folder = shutil.copytree(napkin, tmp_path / napkin.name)
    frame = read_recording(folder).frames[-1]
    (path,) = frame.depth.values()
    assert read_depth(path, 0.001).any()
    path.write_bytes(b"no picture")
    words = ["flatten", str(tmp_path / "plan"), "--policy", "heuristic"]
    assert cli.main([*words, "--recording", str(folder)]) == 1
    assert path.name in capsys.readouterr().err
    assert not (tmp_path / "plan").exists()


def test_the_truth_is_not_to_be_had_in_a_dry_run(napkin, tmp_path, capsys):
    words = ["flatten", str(tmp_path / "plan"), "--perception", "truth"]
    assert cli.main([*words, "--recording", str(napkin)]) == 1
    assert "only the simulated robot" in capsys.readouterr().err


@pytest.mark.slow
def test_dynamics_are_made_and_trained_by_one_call(tmp_path):
    settings = (
        "roll_outs.vertex_count=150", "roll_outs.starts=1", "roll_outs.actions=3",
        "roll_outs.motion.speed=0.8", "roll_outs.states.crumpling.states=1",
        "network.width=16", "network.message_steps=2", "loop.epochs=1", "examples_per_shard=2",
        "loop.held_out_share=0.4",
    )  # fmt: skip
    outcome = lab.train_dynamics(tmp_path, roll_outs=3, settings=settings)
    assert outcome.weights.name == "best.safetensors"
    assert len(list((tmp_path / "roll_outs").glob("*/shards/*.npz"))) == 2
