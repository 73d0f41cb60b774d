"""Trains the token network on simulated states: from nothing, or further."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from clothtrack.errors import InvalidResultError
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import made_with
from clothtrack.files.run_manifest import as_plain
from clothtrack.reconstruction.data.state_examples import RenderConfig
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.model_card import PACKAGES
from clothtrack.reconstruction.tokens.token_examples import TokenExamples
from clothtrack.reconstruction.tokens.token_network import TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_stage import TokenStage, collate_tokens
from clothtrack.reconstruction.training.batches import Subset, split_by_group
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights, save_weights
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train

MODEL = "model.safetensors"
KIND = "any"
"""The garment in the weights' description: the network is told it."""

PREFIX = "tokens."


@dataclass(frozen=True)
class TokenLearningConfig:
    """Everything that a training depends on, but for the network.

    Attributes:
        tokens: the loop.
        rendering: the cameras that see simulated states.
    """

    tokens: TrainingConfig = field(
        default_factory=lambda: TrainingConfig(
            epochs=40,
            low_rate=1e-6,
            high_rate=1e-3,
            rise_epochs=1.0,
            decay="cosine",
            gradient_limit=1.0,
            held_out_share=0.05,
            bfloat16=True,
        )
    )
    rendering: RenderConfig = field(default_factory=RenderConfig)


def pretrain_tokens(
    states: Sequence[StateSet],
    network: TokenNetworkConfig,
    config: TokenLearningConfig,
    folder: Path,
    *,
    start: Path | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train on states of any garments; a second call goes on where the first one stopped.

    Garments are held out as a whole.

    Args:
        states: folders of states.
        network: sizes of the network.
        config: how.
        folder: gets progress, scalars and `model.safetensors`.
        start: weights to begin with, of a network of the same sizes.
        processes: who trains together.
        progress: called after every step.

    Returns:
        How it ended, and the file with the best weights.

    Raises:
        InvalidConfigError: the states are too few.
        InvalidResultError: states, progress or weights are damaged or of another training.
        StorageError: when the disk refuses.
    """
    seed = config.tokens.seed
    examples = TokenExamples(states, network, rendering=config.rendering, seed=seed)
    training, held = split_by_group(examples.groups, config.tokens.held_out_share, seed)
    data: dict[str, Any] = {
        "states": len(examples),
        "sets": [one.folder.name for one in states],
        "rendering": as_plain(asdict(config.rendering)),
    }
    torch.manual_seed(seed)
    # Pictures one pixel after the other: convolutions on a CPU are faster so.
    model = TokenNetwork(network).to(memory_format=torch.channels_last)
    stage = TokenStage(model)
    if start is not None:
        weights = load_weights(start)
        require_tokens(weights)
        weights.load_into(model, prefix=PREFIX)
        data["start"] = as_plain(dict(weights.provenance))
    if processes is not None:
        stage = stage.to(processes.device)
    outcome = train(
        stage,
        Subset(examples, training),
        Subset(examples, held),
        config.tokens,
        folder,
        collate=collate_tokens,
        data=data,
        processes=processes,
        progress=progress,
    )
    if outcome.status == "interrupted" or outcome.weights is None:
        return LearningOutcome({"tokens": outcome}, None)
    file = folder / MODEL
    if processes is None or processes.writes:
        best = load_weights(outcome.weights)
        provenance: Mapping[str, Any] = {
            **best.provenance, "cpu_s": outcome.cpu_s, "made_with": made_with(PACKAGES)
        }  # fmt: skip
        save_weights(file, best.tensors, network, kind=KIND, provenance=provenance)
    return LearningOutcome({"tokens": outcome}, file)


def require_tokens(weights: Weights) -> TokenNetworkConfig:
    """The sizes of a token network, from its weights.

    Raises:
        InvalidResultError: they are of another network.
    """
    if weights.kind != KIND or not any(name.startswith(PREFIX) for name in weights.tensors):
        raise InvalidResultError(
            f"{weights.path}: these are weights of the published network for {weights.kind!r}; "
            "give weights of the token network"
        )
    try:
        return TokenNetworkConfig(**weights.network)
    except TypeError as error:
        raise InvalidResultError(
            f"{weights.path}: its network's sizes are not known here ({error}); give weights of "
            "this version"
        ) from error
