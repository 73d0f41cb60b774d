"""Finds the design that weights belong to, and loads the network."""

from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.extras import require_extra
from clothtrack.reconstruction.availability import EXTRA, shipped_weights
from clothtrack.reconstruction.design import Design, Reconstructor
from clothtrack.reconstruction.token_meshes import TokenMeshes
from clothtrack.reconstruction.tokens.learning_config import LearningConfig
from clothtrack.reconstruction.tokens.token_learning import is_of_tokens
from clothtrack.reconstruction.tokens.token_training import finetune_tokens, pretrain_tokens
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights

TOKENS = Design(
    name="tokens",
    networks=("tokens",),
    extra="learn",
    modules=EXTRA,
    recognizes=is_of_tokens,
    load=TokenMeshes.load,
    configuration=LearningConfig.preset,
    pretrain=pretrain_tokens,
    finetune=finetune_tokens,
)
"""One network for every garment."""


def designs() -> Iterator[Design]:
    """Iterate over the token network and the designs of other installed packages."""
    yield TOKENS
    for found in entry_points(group="clothtrack.networks"):
        yield found.load()


def design_of(weights: Weights) -> Design:
    """Return the design that weights belong to."""
    for design in designs():
        if design.recognizes(weights):
            return _installed(design)
    raise InvalidResultError(
        f"{weights.path}: no installed package knows its network (for {weights.kind!r:.80}); give "
        "weights of the token network or of a published one, which is in clothtrack_lab (weights "
        "of learned dynamics are given as --dynamics-weights)"
    )


def design_named(network: str) -> Design:
    """Return the design that has a network of this name."""
    known = {name: design for design in designs() for name in design.networks}
    if network not in known:
        raise InvalidConfigError(
            f"there is no network {network!r:.80}; choose one of {', '.join(known)}"
        )
    return _installed(known[network])


def _installed(design: Design) -> Design:
    require_extra(design.extra, design.modules, f"the network {design.name!r}")
    return design


def load_model(kind: str, path: Path | None = None, *, device: str = "cpu") -> Reconstructor:
    """Load the network for a kind of garment."""
    path = path or shipped_weights()
    if path is None:
        raise InvalidResultError(
            "no weights come with this installation; train some with clothtrack pretrain, and name "
            "them with --weights"
        )
    weights = load_weights(path)
    return design_of(weights).load(weights, kind, device=device)
