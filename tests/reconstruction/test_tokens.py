"""The token network: what it is told, what it learns from, and how its answers become a mesh."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.garments.garment_meshes import garment, one_layer, shirt, trousers
from clothtrack.garments.outlines import ShirtOutline, TrousersOutline, draw_sweater
from clothtrack.garments.triangulation import Span
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.reconstruction.data.recipes import CrumplingConfig
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.reconstruction.data.state_store import open_states
from clothtrack.reconstruction.data.states import StatesConfig, generate_states
from clothtrack.reconstruction.tokens.garment_tokens import TOKENS, GarmentTokens
from clothtrack.reconstruction.tokens.learning_config import LearningConfig
from clothtrack.reconstruction.tokens.token_examples import (
    LabeledTokenExamples,
    token_example,
)
from clothtrack.reconstruction.tokens.token_network import (
    EMPTY,
    TokenNetwork,
    TokenNetworkConfig,
)
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor
from clothtrack.reconstruction.tokens.token_stage import (
    HARDENING_EXAMPLES,
    TokenExample,
    TokenStage,
    collate_tokens,
)
from clothtrack.reconstruction.tokens.token_training import finetune_tokens, pretrain_tokens
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import read_scalars
from clothtrack_lab.published_networks.registered import SHIPPED
from clothtrack_lab.published_networks.rendered_state import render

TINY = TokenNetworkConfig(width=16, layers=1)
PERFECT = SensorConfig.perfect()
EXACT = RenderConfig(
    sensors=(PERFECT,) * 3,
    mask_jitter=0.0,
    tool=0.0,
    cut=0.0,
    focal=(450.0, 450.0),
)
LONG_SLEEVES = ShirtOutline(sleeve=0.8, sleeve_angle_rad=0.9, cuff=0.13)
CARDIGAN = draw_sweater(np.random.default_rng(1))


@cache
def meshes() -> dict[str, ClothMesh]:
    return {
        "square": garment("towel", vertex_count=500, pattern="random"),
        "rectangle": garment("towel", vertex_count=500, size_m=(0.5, 0.3), pattern="random"),
        "tshirt": garment("tshirt", vertex_count=900),
        "sweater": shirt(LONG_SLEEVES, 0.6, vertex_count=900),
        "cardigan": shirt(CARDIGAN, 0.6, vertex_count=900, open_front=True),
        "trousers": trousers(TrousersOutline(), 0.9, vertex_count=900),
    }


@pytest.fixture(
    scope="module",
    params=["square", "rectangle", "tshirt", "sweater", "cardigan", "trousers"],
)
def told(request: pytest.FixtureRequest) -> tuple[str, ClothMesh, GarmentTokens]:
    return request.param, meshes()[request.param], tokens_of(request.param)


@cache
def tokens_of(name: str) -> GarmentTokens:
    return GarmentTokens.of(meshes()[name])


def example(mesh: ClothMesh, tokens: GarmentTokens, seed: int) -> TokenExample:
    rng = np.random.default_rng(seed)
    positions = np.asarray(mesh.vertices, float) + [0.0, 0.0, 0.01]
    # A wave: every part of the cloth at its own height.
    positions[:, 2] += 0.02 * np.sin(8.0 * positions[:, 0])
    picture = render(positions, mesh, EXACT, rng)
    return token_example(picture, mesh.faces, tokens, TINY, rng)


def test_a_vertex_is_where_its_shares_of_the_tokens_are(told) -> None:
    _, mesh, tokens = told
    apart = tokens.at_vertices(tokens.canonical)[:, :2] - mesh.canonical[:, :2]
    apart = np.linalg.norm(apart, axis=1) / tokens.size_m
    assert apart.mean() < 0.01
    assert apart.max() < 0.06
    assert tokens.vertex_shares.min() >= 0.0
    np.testing.assert_allclose(tokens.vertex_shares.sum(axis=1), 1.0, atol=1e-6)


def test_labelings_are_those_under_which_the_garment_looks_the_same(told) -> None:
    name, _, tokens = told
    rows = tokens.labelings[tokens.is_labeling]
    assert len(rows) == {"square": 8, "rectangle": 4}.get(name, 2)
    np.testing.assert_array_equal(rows[0], np.arange(TOKENS))
    flat, side = tokens.canonical[:, :2], tokens.features[:, 2]
    gaps = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    for number, row in enumerate(rows):
        # Distances within the garment are kept, up to the places of tokens.
        renamed = np.linalg.norm(flat[row][:, None] - flat[row][None], axis=2)
        assert np.abs(renamed - gaps).mean() < 0.02 * tokens.size_m
        if name not in {"square", "rectangle"} and number:
            np.testing.assert_array_equal(side[row], -side)


@pytest.mark.parametrize(
    ("corners", "labelings", "mirrored"),
    [
        ([(0, 0), (1, 0), (1, 1), (0, 1)], 8, True),
        ([(0, 0), (1, 0), (1, 0.6), (0, 0.6)], 4, True),
        # An isosceles triangle is its own mirror image, a parallelogram its own half turn.
        ([(0, 0), (1, 0), (0.5, 0.7)], 2, True),
        ([(0, 0), (0.7, 0), (1, 0.5), (0.3, 0.5)], 2, False),
        ([(0, 0), (1, 0), (1, 0.25), (0.3, 0.25), (0.3, 0.7), (0, 0.7)], 1, False),
        ([(0, 0), (1, 0), (1, 0.3), (0.3, 0.3), (0.3, 1), (0, 1)], 2, False),
    ],
)
def test_an_outline_has_its_own_symmetries(
    corners: list[tuple[float, float]], labelings: int, mirrored: bool
) -> None:
    ends = np.array(corners, float)
    spans = [Span(np.stack(pair)) for pair in zip(ends, np.roll(ends, -1, axis=0), strict=True)]
    tokens = GarmentTokens.of(one_layer(spans, vertex_count=600))
    rows = tokens.labelings[tokens.is_labeling]
    assert len(rows) == labelings
    flat = tokens.canonical[:, :2]
    gaps = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    for row in [*rows, tokens.mirror]:
        renamed = np.linalg.norm(flat[row][:, None] - flat[row][None], axis=2)
        assert np.abs(renamed - gaps).mean() < 0.03 * tokens.size_m
    assert mirrored == (tokens.mirror != np.arange(TOKENS)).any()


def test_the_network_answers_each_picture_by_itself(told) -> None:
    _, mesh, tokens = told
    torch.manual_seed(0)
    network = TokenNetwork(TINY).eval()
    drawn = [example(mesh, tokens, seed) for seed in range(3)]
    drawn[1] = replace(drawn[1], height=np.where(np.arange(128) < 64, EMPTY, drawn[1].height))
    with torch.no_grad():
        together = network(collate_tokens(drawn).asked)
        alone = [network(collate_tokens([one]).asked) for one in drawn]
    for number, answer in enumerate(alone):
        for part, whole in zip(answer, together, strict=True):
            torch.testing.assert_close(part[0], whole[number], atol=2e-4, rtol=1e-3)


def test_the_loss_does_not_ask_which_of_two_look_alikes_it_is(told) -> None:
    name, mesh, tokens = told
    # A towel's tokens lie on one another exactly when it is turned, a shirt's nearly.
    tolerance = 2e-3 if name in {"square", "rectangle"} else 0.03
    torch.manual_seed(1)
    network = TokenNetwork(TINY).eval()
    network.examples.fill_(HARDENING_EXAMPLES)
    stage = TokenStage(network).eval()
    drawn = example(mesh, tokens, 5)
    for row in tokens.labelings[tokens.is_labeling]:
        places = drawn.places.copy()
        places[row] = drawn.places
        other = replace(drawn, pixel_tokens=row[drawn.pixel_tokens], places=places)
        with torch.no_grad():
            first, second = (stage.measure(collate_tokens([one])) for one in (drawn, other))
        for part, value in first.items():
            torch.testing.assert_close(value, second[part], atol=tolerance, rtol=tolerance)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    out = tmp_path_factory.mktemp("states")
    crumpling = CrumplingConfig(states=2, rest_limit_s=0.2)
    config = StatesConfig(vertex_count=250, episodes=2, crumpling=crumpling)
    for kind in ("towel", "tshirt"):
        generate_states(out / kind, kind, 8, seed=3, config=config)
    return [out / "towel", out / "tshirt"]


def _learning(**changes: object) -> LearningConfig:
    training = TrainingConfig(
        **{
            "epochs": 3, "batch_size": 4, "held_out_share": 0.3, "save_steps": 1,
            "gradient_limit": 1.0, "decay": "cosine", "rise_epochs": 0.5, "low_rate": 1e-5,
            **changes,
        }
    )  # fmt: skip
    return LearningConfig(tokens=training, network=TINY)


@pytest.mark.slow
def test_one_network_learns_from_towels_and_shirts_and_goes_on_to_the_same_bits(
    folders: list[Path], tmp_path: Path
) -> None:
    sets = [open_states(folder) for folder in folders]
    whole = pretrain_tokens(sets, _learning(), tmp_path / "whole").model
    pretrain_tokens(sets, _learning(), tmp_path / "parts", progress=_StopAfter(4))
    learned = pretrain_tokens(sets, _learning(), tmp_path / "parts")
    outcome = learned.stages["tokens"]
    assert outcome.status == "finished"
    first, second = (
        TokenReconstructor.load(path).model.state_dict() for path in (whole, learned.model)
    )
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
    further = pretrain_tokens(sets, _learning(), tmp_path / "further", start=whole)
    assert further.stages["tokens"].best_score <= outcome.best_score


def _labeled(mesh: ClothMesh, name: str, table_m: float = 0.0) -> LabeledRecording:
    """Two pictures of a flat garment on a table of some height."""
    up = np.array([0.0, 0.0, table_m])
    lying = np.asarray(mesh.vertices, float)
    lying = lying - [0.0, 0.0, lying[:, 2].min() - 0.0015]
    pictures = []
    for seed in range(2):
        drawn = render(lying, mesh, EXACT, np.random.default_rng(seed))
        pose = drawn.camera.world_from_camera.copy()
        pose[:3, 3] += up
        camera = replace(drawn.camera, world_from_camera=pose)
        pictures.append(replace(drawn, camera=camera, positions=lying + up))
    return LabeledRecording(name, "any", mesh.with_vertices(lying + up), (0, 1), tuple(pictures))


def test_a_label_is_seen_from_its_own_table() -> None:
    mesh = meshes()["rectangle"]
    low, high = (
        LabeledTokenExamples([_labeled(mesh, "one", table_m)], TINY, seed=4)[1, 2]
        for table_m in (0.0, 0.3)
    )
    np.testing.assert_allclose(low.height, high.height, atol=1e-6)
    np.testing.assert_allclose(low.places, high.places, atol=1e-6)
    assert low.distance == pytest.approx(high.distance)


def test_a_label_that_lies_beside_its_picture_is_left_out() -> None:
    mesh = meshes()["rectangle"]
    right = _labeled(mesh, "one")
    beside = replace(right.pictures[1], positions=right.pictures[1].positions + [0.3, 0.0, 0.0])
    mixed = replace(right, pictures=(right.pictures[0], beside))
    assert len(LabeledTokenExamples([right], TINY)) == 2
    assert len(LabeledTokenExamples([mixed], TINY)) == 1
    with pytest.raises(InvalidConfigError, match="no labeled picture whose mesh lies where"):
        LabeledTokenExamples([replace(right, pictures=(beside,))], TINY)


@pytest.mark.slow
def test_labels_teach_the_token_network(folders: list[Path], tmp_path: Path) -> None:
    sets = [open_states(folder) for folder in folders]
    start = load_weights(pretrain_tokens(sets, _learning(), tmp_path / "start").model)
    mesh = meshes()["rectangle"]
    labels = [_labeled(mesh, name) for name in ("one", "two", "three")]
    config = _learning(epochs=20, high_rate=3e-3)
    learned = finetune_tokens(start, labels, config, tmp_path / "tuned")
    outcome = learned.stages["tokens"]
    # The start is measured too: better than that is better than doing nothing.
    assert outcome.best_step > 0
    weights = load_weights(learned.model)
    assert weights.provenance["data"]["labels"] == 6
    TokenReconstructor.of(weights)


class _StopAfter:
    """Asks the training to stop, as a scheduler does."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def __call__(self, name: str, done: int, total: int) -> None:
        del name, total
        if done == self.steps:
            import os
            import signal

            os.kill(os.getpid(), signal.SIGTERM)


def test_workers_do_not_render_for_a_gpu(folders: list[Path], tmp_path: Path) -> None:
    sets = [open_states(folder) for folder in folders]
    with pytest.raises(InvalidConfigError, match="on cuda:0 pictures are rendered there"):
        pretrain_tokens(sets, _learning(workers=2), tmp_path, processes=Processes(device="cuda:0"))


@pytest.mark.gpu
def test_a_gpu_learns_what_a_processor_learns(folders: list[Path], tmp_path: Path) -> None:
    """The same pictures but for the sensors' noise, the same steps: losses stay near each other."""
    sets, runs = [open_states(folder) for folder in folders], {}
    for device in ("cpu", "cuda"):
        pretrain_tokens(
            sets, _learning(log_steps=1), tmp_path / device, processes=Processes(device=device)
        )
        rows = read_scalars(tmp_path / device)
        runs[device] = np.array([row["loss"] for row in rows if row["split"] == "train"])
    assert len(runs["cuda"]) > 3
    np.testing.assert_allclose(runs["cuda"], runs["cpu"], rtol=0.15)


def test_weights_of_another_network_are_refused(folders: list[Path], tmp_path: Path) -> None:
    with pytest.raises(InvalidResultError, match="token network"):
        TokenReconstructor.load(SHIPPED / "towel.safetensors")
    path = tmp_path / "no.safetensors"
    with pytest.raises(InvalidResultError, match="no such"):
        TokenReconstructor.load(path)
