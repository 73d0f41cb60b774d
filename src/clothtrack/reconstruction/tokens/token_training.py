"""Trains the token network: on simulated states, from nothing or further, and on pseudo-labels."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidConfigError
from clothtrack.files.progress import Progress
from clothtrack.files.run_manifest import as_plain
from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.learning_config import LearningConfig
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.tokens.token_examples import LabelledTokenExamples, TokenExamples
from clothtrack.reconstruction.tokens.token_learning import (
    TokenLearning,
    require_tokens,
    split_by_digest,
)
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.reconstruction.training.batches import Examples, Mixture, Subset, split_by_group
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights
from clothtrack.reconstruction.training.processes import Processes


def pretrain_tokens(
    states: Sequence[StateSet],
    network: TokenNetworkConfig,
    config: LearningConfig,
    folder: Path,
    *,
    start: Path | None = None,
    hours: float | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train on states of any garments; a second call goes on where the first one stopped.

    Garments are held out as a whole, by the digest of their states: whatever else is learned from,
    the same ones are. A second call may add folders of states, or leave some out.

    Args:
        states: folders of states.
        network: sizes of the network.
        config: how.
        folder: gets progress, scalars and `model.safetensors`.
        start: weights to begin with; the network may have more layers and hypotheses (`grown`).
        hours: of wall time after which the training pauses; None for no limit.
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
    training, held = split_by_digest(examples.groups, config.tokens.held_out_share)
    data: dict[str, Any] = {
        "states": len(examples),
        "sets": [one.identity for one in states],
        "rendering": config.rendering.as_dict(),
    }
    weights = None
    if start is not None:
        weights = load_weights(start)
        data["start"] = as_plain(dict(weights.provenance))
    learning = TokenLearning(network, config.tokens, folder, processes, progress, hours)
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
    learning = TokenLearning(network, training, folder, processes, progress)
    return learning.of(taught, Subset(examples, held), data, start)
