"""One round of getting better, with a network that has learned nothing and a napkin."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from shared import self_improvement
from shared.round_labels import EpisodeLabels
from shared.self_improvement import ImprovementConfig, improve_rounds

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_worth import LabelWorth
from clothtrack.files.settings import with_settings
from clothtrack.planning.flatten_config import FlattenConfig
from clothtrack.planning.perception import PerceptionConfig
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.planning_dynamics import MotionConfig, SimulatorConfig
from clothtrack.reconstruction.data.state_store import LIST_FILE
from clothtrack.reconstruction.training.checkpoint import save_weights
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.configuration import InitialStateConfig, RunConfig
from clothtrack.tracking.search import SearchConfig
from clothtrack_lab.published_networks.model import MeshReconstructor
from clothtrack_lab.published_networks.network_config import TINY_NETWORK
from clothtrack_lab.published_networks.published_config import PublishedConfig
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.simulated_robot import SimulatedRobotConfig

LEARNING = with_settings(
    PublishedConfig.preset("finetune"),
    (
        "canonicalisation.epochs=1", "completion.epochs=1", "canonicalisation.evaluate_epochs=1",
        "completion.evaluate_epochs=1", "examples.winding.pool=1024",
        "examples.surface_queries=64", "examples.volume_queries=64",
        "canonicalisation.held_out_share=0.4", "completion.held_out_share=0.4",
    ),
)  # fmt: skip


@pytest.mark.slow
def test_a_round_flattens_tracks_labels_and_tunes_and_is_not_done_twice(tmp_path):
    torch.manual_seed(0)
    weights = tmp_path / "towel.safetensors"
    save_weights(
        weights, MeshReconstructor(TINY_NETWORK, "towel").state_dict(), TINY_NETWORK, kind="towel"
    )
    config = ImprovementConfig(
        rounds=1,
        episodes=4,
        flatten=FlattenConfig(
            perception=PerceptionConfig(refined=False, vertex_count=200),
            simulator=SimulatorConfig(motion=MotionConfig(speed=0.8, rest_s=0.1)),
            planner=PlannerConfig(candidates=20),
            actions=1,
        ),
        robot=SimulatedRobotConfig(episode=SMALL_WORLD),
        track=RunConfig(
            search=SearchConfig(method="none"),
            initial_state=InitialStateConfig(vertex_count=200),
        ),
        finetune=LEARNING,
    )
    curve = improve_rounds(weights, tmp_path / "out", "towel", config)
    assert [row["round"] for row in curve] == [0, 1]
    # This network states no error, so that nothing speaks against a label.
    assert curve[0]["labels"]["used"] == curve[0]["labels"]["made"] > 1
    worth = json.loads((tmp_path / "out" / "round_0" / "worth.json").read_text())
    assert all(one["network_mm"] is None and one["label_mm"] > 0.0 for one in worth)
    assert all(row["episodes"] == 4 == len(row["improvement"]) for row in curve)
    assert json.loads((tmp_path / "out" / "improvement.json").read_text()) == curve
    assert len(list((tmp_path / "out" / "starts").iterdir())) == 4
    behind = tmp_path / "out" / "round_0" / "hindsight"
    assert list((behind / "labels").glob("*.labels.npz"))
    for one in (behind / "recordings").iterdir():
        backwards = read_recording(one)
        forwards = read_recording(tmp_path / "out/round_0/flattening/recordings" / one.name)
        assert len(backwards.frames) == len(forwards.frames)
        assert backwards.provenance["reversed"] == one.name
    assert (tmp_path / "out" / "round_0" / "tuned" / "model.safetensors").exists()
    assert improve_rounds(weights, tmp_path / "out", "towel", config) == curve


def test_too_few_labels_are_told(tmp_path, monkeypatch):
    weights = tmp_path / "towel.safetensors"
    weights.write_bytes(b"weights")
    monkeypatch.setattr(self_improvement, "_require_inputs", lambda *_, **__: None)
    monkeypatch.setattr(self_improvement, "_flattened", lambda *_, **__: [0.1, 0.3])
    one = EpisodeLabels(tmp_path / "one", tmp_path)
    monkeypatch.setattr(self_improvement, "label_episodes", lambda *_, **__: [one])
    with pytest.raises(ClothTrackError, match="1 of 2 episodes"):
        improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(episodes=2))
    (row,) = json.loads((tmp_path / "out" / "improvement.json").read_text())
    assert row["mean"] == pytest.approx(0.2)


def weighed(monkeypatch, *, used):
    """Two episodes of two labels each a round, of which the first so many teach anything."""

    def worth_of(labels, weights, kind, teaches, **more):
        return [
            LabelWorth(labels[number // 2].path.name, number % 2, 5.0, 9.0, used=number < used)
            for number in range(2 * len(labels))
        ]

    two = [EpisodeLabels(Path(name), Path(name)) for name in ("a", "b")]
    monkeypatch.setattr(self_improvement, "label_episodes", lambda *_, **__: two)
    monkeypatch.setattr(self_improvement, "worth_of", worth_of)
    monkeypatch.setattr(
        self_improvement, "taught",
        lambda labels, worth: {one.recording for one in worth if one.used},
    )  # fmt: skip


def test_rounds_end_where_no_label_teaches_anything(tmp_path, monkeypatch):
    weights = tmp_path / "w0"
    weights.write_bytes(b"0")
    monkeypatch.setattr(self_improvement, "_require_inputs", lambda *_, **__: None)
    monkeypatch.setattr(self_improvement, "_flattened", lambda *_, **__: [0.1, 0.3])
    # Both of one recording: nothing is left to select by.
    weighed(monkeypatch, used=2)
    curve = improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(rounds=3))
    (row,) = curve
    assert row["labels"] == {"made": 4, "used": 2}
    assert "better than the network" in row["stopped"]
    assert json.loads((tmp_path / "out" / "improvement.json").read_text()) == curve
    assert not (tmp_path / "out" / "round_0" / "tuned").exists()


def test_rounds_hand_their_weights_on(tmp_path, monkeypatch):
    asked = []
    weights = tmp_path / "w0"
    weights.write_bytes(b"0")

    def flattened(folder, starts, given, kind, config, **more):
        asked.append((given.name, starts))
        return [0.1 * len(asked)]

    def tuned(given, labels, folder, config, **more):
        assert len(labels) == 2
        path = tmp_path / f"w{len(asked)}"
        path.write_bytes(path.name.encode())
        return path

    monkeypatch.setattr(self_improvement, "_require_inputs", lambda *_, **__: None)
    monkeypatch.setattr(self_improvement, "_flattened", flattened)
    weighed(monkeypatch, used=3)
    monkeypatch.setattr(self_improvement, "_tuned", tuned)
    curve = improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(rounds=2))
    assert [name for name, _ in asked] == ["w0", "w1", "w2"]
    assert len({starts for _, starts in asked}) == 1
    assert [row["mean"] for row in curve] == pytest.approx([0.1, 0.2, 0.3])
    # Of the labels of all rounds so far, three each time.
    assert [row.get("labels") for row in curve] == [
        {"made": 4, "used": 3}, {"made": 8, "used": 3}, None
    ]  # fmt: skip
    assert len(json.loads((tmp_path / "out" / "round_1" / "worth.json").read_text())) == 8
    # More rounds of the same go on; rounds of something else would be mixed with them.
    improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(rounds=0))
    with pytest.raises(InvalidConfigError, match=r"another settings\.old_share"):
        improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(old_share=0.5))
    with pytest.raises(InvalidConfigError, match="another teaches"):
        improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(), teaches=any)
    with pytest.raises(InvalidConfigError, match="another garment_seed"):
        improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(), garment_seed=1)
    with pytest.raises(InvalidConfigError, match=r"weights_sha256\.network"):
        improve_rounds(tmp_path / "w1", tmp_path / "out", "towel", ImprovementConfig())
    states = tmp_path / "states" / LIST_FILE
    states.parent.mkdir()
    states.write_text("{}")
    with pytest.raises(InvalidConfigError, match="another old"):
        improve_rounds(weights, tmp_path / "out", "towel", ImprovementConfig(), old=states.parent)


@pytest.mark.parametrize(
    ("asked", "told"), [({"rounds": -1}, "rounds"), ({"episodes": 1}, "labelled episodes")]
)
def test_rounds_that_cannot_end_well_are_refused(asked, told):
    with pytest.raises(InvalidConfigError, match=told):
        ImprovementConfig(**asked)


def test_what_cannot_be_read_is_refused_before_anything_is_written(tmp_path):
    torch.manual_seed(0)
    good, bad = tmp_path / "good.safetensors", tmp_path / "bad.safetensors"
    save_weights(
        good, MeshReconstructor(TINY_NETWORK, "towel").state_dict(), TINY_NETWORK, kind="towel"
    )
    bad.write_bytes(good.read_bytes()[:100])
    out, config = tmp_path / "out", ImprovementConfig(finetune=LEARNING)
    learned = replace(config, flatten=FlattenConfig(dynamics="mesh", dynamics_weights=str(bad)))
    for weights, kind, asked, old in (
        (bad, "towel", config, None),
        (tmp_path / "none.safetensors", "towel", config, None),
        (good, "tshirt", config, None),
        (good, "towel", learned, None),
        (good, "towel", config, tmp_path / "no_states"),
    ):
        with pytest.raises(InvalidResultError):
            improve_rounds(weights, out, kind, asked, old=old)
    assert not out.exists()


def test_a_template_beside_a_garment_seed_is_refused_and_nothing_is_written(tmp_path):
    out, weights = tmp_path / "out", tmp_path / "weights"
    weights.write_bytes(b"none")
    named = FlattenConfig(perception=PerceptionConfig(template="mine.npz"))
    with pytest.raises(InvalidConfigError, match="own cut and size"):
        improve_rounds(weights, out, "towel", ImprovementConfig(flatten=named), garment_seed=1)
    assert not out.exists()
