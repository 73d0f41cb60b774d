"""Trains the token network: on simulated states, from nothing or further, and on pseudo-labels."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.progress import Progress
from clothtrack.files.provenance import made_with
from clothtrack.files.run_manifest import as_plain
from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.learning_config import LearningConfig
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.model_card import PACKAGES
from clothtrack.reconstruction.tokens.token_examples import LabelledTokenExamples, TokenExamples
from clothtrack.reconstruction.tokens.token_network import TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_stage import TokenStage, collate_tokens
from clothtrack.reconstruction.training.batches import Examples, Mixture, Subset, split_by_group
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights, save_weights
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train

MODEL = "model.safetensors"
KIND = "any"
"""The garment in the weights' description: the network is told it."""

PREFIX = "tokens."


def pretrain_tokens(
    states: Sequence[StateSet],
    network: TokenNetworkConfig,
    config: LearningConfig,
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
    weights = None
    if start is not None:
        weights = load_weights(start)
        require_tokens(weights)
        data["start"] = as_plain(dict(weights.provenance))
    learning = _Learning(network, config.tokens, folder, processes, progress)
    return learning.of(Subset(examples, training), Subset(examples, held), data, weights)


def finetune_tokens(
    start: Weights,
    labels: Sequence[LabelledRecording],
    config: LearningConfig,
    folder: Path,
    *,
    old: Sequence[StateSet] = (),
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train further on pseudo-labels; recordings are held out as a whole.

    Arguments and errors are those of `fine_tuning.finetune`, but that the weights are read.
    """
    network, training = require_tokens(start), config.tokens
    examples = LabelledTokenExamples(labels, network, seed=training.seed)
    chosen, held = split_by_group(examples.groups, training.held_out_share, training.seed)
    data: dict[str, Any] = {
        "start": as_plain(dict(start.provenance)),
        "recordings": sorted(set(examples.groups)),
        "labels": len(examples),
    }
    taught: Examples = Subset(examples, chosen)
    if training.old_share > 0.0:
        if not old:
            raise InvalidConfigError("old_share is above 0, but no old states are given; name them")
        others = TokenExamples(old, network, rendering=config.rendering, seed=training.seed)
        taught = Mixture(taught, others, training.old_share, seed=training.seed)
        data["old_states"] = len(others)
    learning = _Learning(network, training, folder, processes, progress)
    return learning.of(taught, Subset(examples, held), data, start)


@dataclass(frozen=True, eq=False)
class _Learning:
    """One training of the token network."""

    network: TokenNetworkConfig
    config: TrainingConfig
    folder: Path
    processes: Processes | None
    progress: Progress | None

    def of(
        self, taught: Examples, held: Examples, data: dict[str, Any], start: Weights | None
    ) -> LearningOutcome:
        """Train on examples, and write the weights that were best on the others."""
        torch.manual_seed(self.config.seed)
        # Pictures one pixel after the other: convolutions on a CPU are faster so.
        model = TokenNetwork(self.network).to(memory_format=torch.channels_last)
        stage = TokenStage(model)
        if start is not None:
            start.load_into(model, prefix=PREFIX)
        if self.processes is not None:
            stage = stage.to(self.processes.device)
        outcome = train(
            stage,
            taught,
            held,
            self.config,
            self.folder,
            collate=collate_tokens,
            data=data,
            processes=self.processes,
            progress=self.progress,
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
