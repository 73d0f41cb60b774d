"""The flattening experiment: which methods, what its table says, and its figure."""

import shutil

import numpy as np
import pytest
from figures import flattening_figure
from shared import tables
from shared.bench_runs import read_rows, write_rows
from tables import flattening, network_on_heaps, planning_dynamics

METHODS = {"random": 0.1, "control: truth, simulator": 0.5, "pretrained": 0.3, "fine-tuned": 0.45}
USED, EPISODES = 2, 3


def rows_of(method, gained, hashed):
    return [
        {
            "experiment": "flattening", "variant": method, "recording": f"tshirt_900{episode}",
            "kind": "tshirt", "split": "", "action": action, "actions": USED, "stage": "after",
            "improvement": (gained + 0.1 * episode) * action / USED, "share": 0.5,
            "seen_share": 0.5, "start_share": 0.4, "used": USED, "missed": 0.0,
            "expected_m2": 0.01, "gain_m2": 0.01, "perception_cpu_s": 1.0, "decision_cpu_s": 5.0,
            "control": method.startswith("control"),
            "provenance": {"config_hash": hashed, "commit": "0", "clothtrack": "0"},
        }
        for episode in range(EPISODES)
        for action in range(1, USED + 1)
    ]  # fmt: skip


@pytest.fixture
def rows():
    return [row for n, (name, gained) in enumerate(METHODS.items())
            for row in rows_of(name, gained, f"{n:010d}")]  # fmt: skip


def names(*words):
    return [one.name for one in flattening.methods(flattening.parse(["--out", "out", *words]))]


def test_methods_without_their_weights_are_left_out_and_some_can_be_chosen():
    everything = names("--weights", "w", "--tuned", "t", "--dynamics", "d")
    assert len(everything) == len(set(everything))
    without = names()
    assert set(without) < set(everything)
    assert not [name for name in without if name.startswith(("pretrained", "fine-tuned"))]
    assert names("--only", "random", "heuristic") == ["random", "heuristic"]
    assert names("--only", "control: truth, simulator") == ["control: truth, simulator"]
    assert len(names("--only", "control")) > 1
    assert flattening.parse(["--out", "out"]).kind == ["tshirt"]
    both = flattening.parse(["--out", "out", "--kind", "tshirt", "--kind", "towel"])
    assert both.kind == ["tshirt", "towel"]


def test_the_table_tells_pairs_the_curve_and_the_targets(rows):
    text = tables.markdown("flattening", rows)
    assert "Paired by recording, minus *random*" in text
    # Means of the three episodes: gained + 0.1.
    assert "fine-tuned over pretrained: 1.38" in text
    assert "+0.150 ± 0.000 over 3 shared starts" in text
    assert "fine-tuned over the upper bound: 0.92" in text
    assert "fine-tuned: 0.550 (target: 0.45 or more)" in text
    (line,) = [line for line in text.splitlines() if line.startswith("| pretrained | 0.2")]
    assert line == "| pretrained | 0.200 | 0.400 |"


def test_the_figure_is_drawn_from_the_rows(rows, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra [experiments] brings it")
    write_rows(rows, tmp_path / "flattening.jsonl")
    arguments = ["--out", str(tmp_path), "--image", str(tmp_path / "figure.png")]
    assert flattening_figure.main(arguments) == 0
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_what_the_dynamics_promise_is_ranked_against_what_came():
    def row(variant, action, promised, gained):
        return {
            "experiment": "planning_dynamics", "variant": variant, "recording": "towel_0",
            "kind": "towel", "split": "", "action": action, "actions": 4, "stage": "after",
            "policy": "random", "end_error_mm": 10.0 * action, "still_mm": 50.0,
            "rest_error_mm": 1.0, "promised_m2": promised, "gain_m2": gained,
        }  # fmt: skip

    gains = (0.001, 0.002, 0.003, 0.004)
    rows = [row("simulator", n, gain, gain) for n, gain in enumerate(gains, start=1)]
    rows += [row("learned mesh dynamics", n, -gain, gain) for n, gain in enumerate(gains, start=1)]
    text = tables.markdown("planning_dynamics", rows)
    assert "| simulator | 1.00 (4) |" in text
    assert "| learned mesh dynamics | -1.00 (4) |" in text
    assert "| simulator | 1 | 25.0 ± - | 25.0 | 50.0 |" in text


@pytest.mark.slow
def test_every_action_that_was_done_is_predicted_by_all_dynamics(tmp_path, capsys):
    torch = pytest.importorskip("torch", reason="the extra [learn] brings it")
    from clothtrack.reconstruction.training.checkpoint import save_weights
    from clothtrack_lab.graph_dynamics.mesh_network import MeshNetwork, MeshNetworkConfig

    out = tmp_path / "out"
    assert flattening.main(["--smoke", "--out", str(out), "--only", "random"]) == 0
    torch.manual_seed(0)
    config = MeshNetworkConfig(width=16, message_steps=1)
    weights = tmp_path / "dynamics.safetensors"
    save_weights(weights, MeshNetwork(config).state_dict(), config, kind="towel")
    words = ["--out", str(out), "--kind", "towel", "--dynamics", str(weights)]
    assert planning_dynamics.main(words) == 0
    assert "Rank correlation" in capsys.readouterr().out
    (start,) = [row for row in read_rows(out / "flattening.jsonl") if row["action"] == 1]
    assert start["world_crossings"] >= 0
    assert start["out_of_picture"] == 0.0
    rows = read_rows(out / "planning_dynamics.jsonl")
    moved = [row for row in rows if "end_error_mm" in row]
    assert len(moved) == 2 * len(planning_dynamics.contenders(weights, "cpu"))
    assert all(np.isfinite(row["end_error_mm"]) and row["still_mm"] > 0.0 for row in moved)
    decided = [row for row in rows if "decision_cpu_s" in row]
    assert [row["candidates"] for row in decided] == [100, 100, 100]
    assert decided[0]["agreement"] == pytest.approx(1.0)
    assert planning_dynamics.main(["--out", str(tmp_path), "--dynamics", str(weights)]) == 1
    assert "no episodes" in capsys.readouterr().err


@pytest.mark.slow
def test_networks_are_compared_on_the_pictures_of_episodes(tmp_path, capsys):
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    out = tmp_path / "out"
    assert flattening.main(["--smoke", "--out", str(out), "--only", "random", "pretrained"]) == 0
    capsys.readouterr()
    # The same network makes the same mesh of the same picture again.
    weights = out / "tiny.safetensors"
    twin = shutil.copy(weights, tmp_path / "twin.safetensors")
    words = ["--out", str(out), "--kind", "towel", "--weights", str(weights), str(twin)]
    assert network_on_heaps.main([*words, "--every", "1"]) == 0
    assert "| +0.0 ± nan | 0 of 1 |" in capsys.readouterr().out
    again = read_rows(out / "network_on_heaps.jsonl")
    assert all(np.isfinite(row["error_symmetric_mm"]) for row in again)
    # Two episodes, one start: its picture counts once for each network.
    assert [row["action"] for row in again].count(0) == 2
    assert network_on_heaps.main(["--out", str(tmp_path), "--weights", str(weights)]) == 1
    assert "no finished episode" in capsys.readouterr().err
