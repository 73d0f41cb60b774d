"""The mesh dynamics that come along: whole, described, and better than standing still."""

import hashlib

import pytest
from safetensors import safe_open

from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M
from clothtrack.reconstruction.availability import SHIPPED as TOKENS
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack_lab.graph_dynamics.mesh_network import MeshNetwork, MeshNetworkConfig
from clothtrack_lab.graph_dynamics.mesh_training import whole_roll_outs
from clothtrack_lab.graph_dynamics.registered import SHIPPED_WEIGHTS
from clothtrack_lab.graph_dynamics.roll_outs import RollOutConfig, generate_roll_outs
from clothtrack_lab.published_networks.registered import SHIPPED as PUBLISHED

UNSEEN_SEED = 4711


NETWORKS = [TOKENS / "tokens.safetensors", *sorted(PUBLISHED.glob("*.safetensors"))]


@pytest.mark.parametrize(
    ("weights", "limit_mb"),
    [(SHIPPED_WEIGHTS, 2.0), *((path, 10.0) for path in NETWORKS)],
    ids=lambda value: getattr(value, "stem", None),
)
def test_a_card_lies_beside_the_weights_and_is_of_them(weights, limit_mb):
    content = weights.read_bytes()
    assert len(content) < limit_mb * 1e6
    card = weights.with_suffix(".md").read_text(encoding="utf-8")
    assert hashlib.sha256(content).hexdigest() in card
    assert f"`{weights.name}`" in card
    with safe_open(weights, framework="pt") as file:
        assert len(file.metadata()["sha256"]) == 64
    load_weights(weights)


@pytest.mark.parametrize("kind", DEFAULT_SIZES_M)
def test_they_beat_standing_still_on_a_garment_that_they_never_saw(kind, tmp_path):
    config = RollOutConfig(vertex_count=300, starts=1, actions=6)
    shards = generate_roll_outs(tmp_path, kind, 6, seed=UNSEEN_SEED, config=config)
    weights = load_weights(SHIPPED_WEIGHTS)
    network = MeshNetwork(MeshNetworkConfig(**weights.network))
    weights.load_into(network)
    errors = whole_roll_outs(network, shards)
    assert errors["whole_error_mm"] < 0.65 * errors["whole_still_mm"]
