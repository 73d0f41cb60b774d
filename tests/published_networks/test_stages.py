"""The two stages learn what they are shown, and measure errors as they are."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.reconstruction.data.state_store import StateShard, write_states
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train
from clothtrack_lab.published_networks.canonical_frame import canonical_frame
from clothtrack_lab.published_networks.canonicalisation import Canonicaliser
from clothtrack_lab.published_networks.completion import observe_pictures
from clothtrack_lab.published_networks.examples import ExampleConfig, collate
from clothtrack_lab.published_networks.network_config import NetworkConfig
from clothtrack_lab.published_networks.stages import (
    canonicalisation_stage,
    completion_stage,
    nearest_labeling,
)
from clothtrack_lab.published_networks.state_examples import StateExamples
from clothtrack_lab.published_networks.winding import WindingConfig

TINY = NetworkConfig(
    image_size=64,
    widths=(16, 32, 48),
    decoder_width=32,
    bins=32,
    volume=16,
    volume_channels=16,
    point_hidden=32,
    volume_widths=(16, 32),
    decoder_hidden=64,
    grid=16,
)


def examples_of(folder, kind, *, count=4, turn=False):
    mesh = garment(kind, vertex_count=300)
    rng = np.random.default_rng(1)
    states = []
    for _ in range(count):
        x, y, _ = np.asarray(mesh.vertices).T
        line = rng.uniform(-0.03, 0.03)
        folded = x + 0.3 * y > line
        shape = np.column_stack([np.where(folded, 2 * (line - 0.3 * y) - x, x), y, 0.02 * folded])
        states.append(shape + (0.0, 0.0, 0.005 + 0.0 * x.mean()))
    positions = np.stack(states).astype(np.float32)
    shard = StateShard(kind, mesh, positions, np.arange(count), ("drop",) * count, 0)
    config = ExampleConfig(
        surface_queries=256,
        volume_queries=256,
        turn=turn,
        mirror=False,
        winding=WindingConfig(pool=2048),
    )
    exact = SensorConfig.perfect()
    filming = RenderConfig(
        sensors=(exact,) * 3,
        mask_jitter=0.0, tool=0.0, cut=0.0,
    )  # fmt: skip
    return StateExamples([write_states(folder, kind, [shard], {})], TINY, config, rendering=filming)


class Learned(Canonicaliser):
    """Answers with the true coordinates, relabeled, as one that has learned would."""

    def __init__(self, unit, signs, bins=256):
        super().__init__(replace(TINY, bins=bins))
        place = (0.5 + (unit - 0.5) * torch.tensor(signs)) * bins - 0.5
        bin_numbers = torch.arange(bins)
        self.answers = -2.0 * (place[..., None] - bin_numbers).abs()

    def forward(self, depth):
        return depth

    def pixel_features(self, features, pixels):
        return torch.zeros(len(pixels), 8)

    def logits(self, features, pixels):
        return self.answers


@pytest.mark.slow
def test_stage_one_learns_what_it_is_shown(tmp_path):
    """Median error down to less than half on fixed pictures, in a few dozen steps."""
    examples = examples_of(tmp_path / "states", "tshirt")
    stage = canonicalisation_stage(TINY, "tshirt")
    config = TrainingConfig(epochs=40, batch_size=4, evaluate_epochs=20)
    outcome = train(stage, examples, examples, config, tmp_path / "run", collate=collate)
    batch = collate([examples[index, 0] for index in range(4)])
    untrained = canonicalisation_stage(TINY, "tshirt").eval()
    with torch.no_grad():
        before = float(untrained.measure(batch)["median_error_mm"].mean())
    assert outcome.best_score < 0.5 * before


@pytest.mark.slow
def test_stage_two_learns_what_it_is_shown(tmp_path):
    examples = examples_of(tmp_path / "states", "tshirt")
    first = canonicalisation_stage(TINY, "tshirt")
    stage = completion_stage(first.canonicaliser, "tshirt")
    frozen = {k: v.clone() for k, v in first.canonicaliser.state_dict().items()}
    config = TrainingConfig(epochs=40, batch_size=4, evaluate_epochs=20, low_rate=3e-3,
                            high_rate=3e-3)  # fmt: skip
    outcome = train(stage, examples, examples, config, tmp_path / "run", collate=collate)
    batch = collate([examples[index, 0] for index in range(4)])
    fresh = completion_stage(first.canonicaliser, "tshirt").eval()
    with torch.no_grad():
        before = {name: float(value.mean()) for name, value in fresh.measure(batch).items()}
        after = {name: float(value.mean()) for name, value in stage.eval().measure(batch).items()}
    assert outcome.best_score < 0.6 * before["vertex_error_mm"]
    assert after["winding_error"] < before["winding_error"]
    for name, value in first.canonicaliser.state_dict().items():
        assert torch.equal(value, frozen[name]), name


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_errors_up_to_symmetry_forgive_a_look_alike_and_plain_ones_do_not(tmp_path, kind):
    examples = examples_of(tmp_path, kind, count=2)
    batch = collate([examples[index, 0] for index in range(2)])
    stage = canonicalisation_stage(TINY, kind)
    for signs in stage.signs[1:].tolist():
        stage.canonicaliser = Learned(batch.unit, signs)
        stage.network = stage.canonicaliser.config
        found = stage.measure(batch)
        assert float(found["median_error_mm"].max()) < 2.0
        assert float(found["share_found"].min()) > 0.99
        assert float(found["median_error_as_drawn_mm"].min()) > 20.0


def test_canonical_errors_are_in_millimeters(tmp_path):
    examples = examples_of(tmp_path, "tshirt", count=2)
    batch = collate([examples[index, 0] for index in range(2)])
    stage = canonicalisation_stage(TINY, "tshirt")
    stage.canonicaliser = Learned(batch.unit + torch.tensor([0.0, 0.03, 0.0]), [1.0, 1.0, 1.0])
    stage.network = stage.canonicaliser.config
    expected = 1e3 * 0.03 / canonical_frame("tshirt").scale
    found = stage.measure(batch)
    assert float(found["mean_error_as_drawn_mm"].mean()) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_labeling_is_the_one_that_the_network_has_chosen(tmp_path, kind):
    examples = examples_of(tmp_path, kind, count=2, turn=True)
    batch = collate([examples[index, 0] for index in range(2)])
    signs = canonicalisation_stage(TINY, kind).signs
    for number, one in enumerate(signs.tolist()):
        seen, _, alignments = observe_pictures(
            Learned(batch.unit, one), canonical_frame(kind), batch.depth, batch.pixels,
            batch.points.double().numpy(),
        )  # fmt: skip
        assert nearest_labeling(seen, batch, signs).tolist() == [number] * 2
        # Aligned, the unfolded part of the cloth lies where its labels say.
        gap = (seen.aligned + 0.5 - seen.unit)[:, :2].norm(dim=1)
        assert float(gap.median()) < 0.15
        assert len(alignments) == 2


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_loss_does_not_care_which_look_alike_was_drawn(tmp_path, kind):
    """Relabeling an exactly symmetric cloth changes no loss: winding, warp or bins."""
    examples = examples_of(tmp_path, kind, count=2)
    batch = collate([examples[index, 0] for index in range(2)])
    first = canonicalisation_stage(TINY, kind, seed=2).eval()
    second = completion_stage(first.canonicaliser, kind, seed=2).eval()
    losses = []
    for signs in first.signs:
        turned = {
            name: 0.5 + (getattr(batch, name) - 0.5) * signs
            for name in ("unit", "surface", "volume")
        }
        sign = float(signs[2]) if kind == "towel" else 1.0
        relabeled = type(batch)(**{**batch.__dict__, **turned, "winding": batch.winding * sign})
        with torch.no_grad():
            losses.append([float(first(relabeled)["loss"]), float(second(relabeled)["loss"])])
    np.testing.assert_allclose(losses, [losses[0]] * len(losses), rtol=1e-4)
