"""One training of the token network: start weights, training, and the written model."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Int
from torch import nn

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import made_with
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.tokens.token_network import TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_stage import TokenStage, collate_tokens
from clothtrack.reconstruction.training.batches import Examples
from clothtrack.reconstruction.training.checkpoint import (
    PACKAGES,
    Weights,
    load_weights,
    save_weights,
)
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import Collate, train

MODEL = "model.safetensors"
KIND = "any"
"""Garment in the weights' description; it is any, because the garment is an input."""

PREFIX = "tokens."


@dataclass(frozen=True, eq=False)
class TokenLearning:
    """One training of the token network.

    Attributes:
        hours: wall time after which the training pauses [h]; None for no limit.
    """

    network: TokenNetworkConfig
    config: TrainingConfig
    folder: Path
    processes: Processes | None
    progress: Progress | None
    hours: float | None = None
    collate: Collate = collate_tokens

    def of(
        self, taught: Examples, held: Examples, data: dict[str, Any], start: Weights | None
    ) -> LearningOutcome:
        """Train on examples, and write the weights that were best on the held-out ones."""
        torch.manual_seed(self.config.seed)
        # The channels-last layout makes convolutions on a CPU faster.
        model = TokenNetwork(self.network).to(memory_format=torch.channels_last)
        stage = TokenStage(model)
        if start is not None:
            grown(start, self.network).load_into(model, prefix=PREFIX)
        if self.processes is not None:
            stage = stage.to(self.processes.device)
        outcome = train(
            stage,
            taught,
            held,
            self.config,
            self.folder,
            collate=self.collate,
            data=data,
            processes=self.processes,
            progress=self.progress,
            hours=self.hours,
        )
        if outcome.status == "interrupted" or outcome.weights is None:
            return LearningOutcome({"tokens": outcome}, None)
        file = self.folder / MODEL
        if self.processes is None or self.processes.writes:
            best = load_weights(outcome.weights)
            provenance: Mapping[str, Any] = {
                **best.provenance, "cpu_s": outcome.cpu_s, "made_with": made_with(PACKAGES)
            }  # fmt: skip
            save_weights(file, best.tensors, self.network, kind=KIND, provenance=provenance)
        return LearningOutcome({"tokens": outcome}, file)


def grown(weights: Weights, network: TokenNetworkConfig) -> Weights:
    """Return weights for a network of more layers or other hypotheses, with the same first answer.

    A new layer adds zero at first, and a new hypothesis is a copy of the first with a little noise.
    """
    old = require_tokens(weights)
    free = {"layers": network.layers, "hypotheses": network.hypotheses}
    if replace(old, **free) != network or old.layers > network.layers:
        other = ", ".join(
            f"network.{one.name} is {getattr(network, one.name)}, there {getattr(old, one.name)}"
            for one in fields(network) if getattr(network, one.name) != getattr(old, one.name)
        )  # fmt: skip
        raise InvalidResultError(
            f"{weights.path}: {other}; a start may have fewer layers and other hypotheses, and all "
            "else must be equal"
        )
    tensors = dict(weights.tensors)
    model = TokenNetwork(network)
    for number in range(old.layers, network.layers):
        layer = cast("nn.Module", model.layers[number])
        for name, value in layer.state_dict().items():
            silent = name.startswith(("join.", "perceptron.2."))
            tensors[f"{PREFIX}layers.{number}.{name}"] = value * 0.0 if silent else value
    if old.hypotheses != network.hypotheses:
        rng = torch.Generator().manual_seed(0)
        for name in ("place.2.weight", "place.2.bias"):
            first = tensors[PREFIX + name][:5]
            copies = first.repeat(network.hypotheses, *[1] * (first.ndim - 1))
            noise = _NOISE * first.std() * torch.randn(copies.shape, generator=rng)
            noise[: len(first)] = 0.0
            tensors[PREFIX + name] = copies + noise
        for name, value in model.state_dict().items():
            if name.startswith("choice."):
                tensors[PREFIX + name] = torch.zeros_like(value)
        if network.hypotheses == 1:
            tensors = {k: v for k, v in tensors.items() if not k.startswith(f"{PREFIX}choice.")}
    return replace(weights, tensors=tensors, network=asdict(network))


_NOISE = 0.1
"""Noise of a new hypothesis, over the standard deviation of the weights it is copied from."""


def split_by_digest(
    digests: Sequence[str], held_out_share: float
) -> tuple[Int[np.ndarray, " training"], Int[np.ndarray, " held_out"]]:
    """Return indices to train on and to hold out; equal digests stay together.

    Whether a garment is held out depends on its own digest alone, so the same garments are held out
    whatever else is trained on. The garment with the lowest digest is always held out.
    """
    names = set(digests)
    chosen = {name for name in names if int(name[:8], 16) < held_out_share * 16**8}
    chosen |= {min(names)}
    if names == chosen:
        raise InvalidConfigError(
            f"{len(digests)} states of {len(names)} garments, of which {len(chosen)} are held out "
            f"at a held_out_share of {held_out_share}; training needs one more: add states"
        )
    is_held = np.array([name in chosen for name in digests])
    return np.flatnonzero(~is_held), np.flatnonzero(is_held)


def is_of_tokens(weights: Weights) -> bool:
    """Return whether weights are of a token network."""
    return weights.kind == KIND and any(name.startswith(PREFIX) for name in weights.tensors)


def require_tokens(weights: Weights) -> TokenNetworkConfig:
    """Return the sizes of a token network from its weights."""
    if not is_of_tokens(weights):
        raise InvalidResultError(
            f"{weights.path}: these are weights of another network, for {weights.kind!r}; give "
            "weights of the token network"
        )
    try:
        # Weights written before hypotheses were introduced have one.
        return TokenNetworkConfig(**{"hypotheses": 1, **weights.network})
    except TypeError as error:
        raise InvalidResultError(
            f"{weights.path}: its network's sizes are not known here ({error}); give weights of "
            "this version"
        ) from error
