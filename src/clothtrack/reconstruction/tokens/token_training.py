"""Trains the token network: on simulated states, from scratch or from weights, and on labels."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidConfigError
from clothtrack.files.progress import Progress
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.tokens.learning_config import LearningConfig
from clothtrack.reconstruction.tokens.token_examples import LabeledTokenExamples
from clothtrack.reconstruction.tokens.token_learning import (
    TokenLearning,
    require_tokens,
    split_by_digest,
)
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_pictures import TokenPictures
from clothtrack.reconstruction.tokens.token_states import read_token_states
from clothtrack.reconstruction.training.batches import Subset, split_by_group
from clothtrack.reconstruction.training.checkpoint import START, Weights, load_weights
from clothtrack.reconstruction.training.processes import Processes


def pretrain_tokens(
    states: Sequence[StateSet],
    config: LearningConfig,
    folder: Path,
    *,
    start: Path | None = None,
    hours: float | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train on states of any garments; a second call resumes where the first one stopped.

    Pictures are rendered on the network's device. Garments are held out as a whole, by the digest
    of their states, so the same ones are held out whatever else is trained on. A second call may
    add folders of states or leave some out.

    Args:
        hours: wall time after which the training pauses [h]; None for no limit.
    """
    loop, network = config.tokens, config.network or TokenNetworkConfig()
    if hours is not None and not hours > 0.0:
        raise InvalidConfigError(f"the hours are {hours:g}; give a number above 0")
    if loop.decay == "stable" and hours is None and not loop.fall_examples:
        raise InvalidConfigError(
            "the token network learns for as long as it is given time; add --hours N, or --set "
            "tokens.fall_examples=N to let its rate fall and the training end"
        )
    device = "cpu" if processes is None else processes.device
    if loop.workers and device.startswith("cuda"):
        raise InvalidConfigError(
            f"tokens.workers is {loop.workers}: on {device} pictures are rendered there, by the "
            "process that learns; leave it out"
        )
    read, digests = read_token_states(states)
    examples = TokenPictures(read, network, device=device, seed=loop.seed)
    training, held = split_by_digest(digests, loop.held_out_share)
    data: dict[str, Any] = {
        "states": len(examples),
        "sets": [one.identity for one in states],
        "rendering": examples.rendering.as_dict(),
    }
    weights = None
    if start is not None:
        weights = load_weights(start)
        data[START] = weights.runs
    learning = TokenLearning(network, loop, folder, processes, progress, hours, examples.rendered)
    return learning.of(Subset(examples, training), Subset(examples, held), data, weights)


def finetune_tokens(
    start: Weights,
    labels: Sequence[LabeledRecording],
    config: LearningConfig,
    folder: Path,
    *,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Fine-tune on pseudo-labels (paper, Sec. III-C); recordings are held out as a whole."""
    network, training = require_tokens(start), config.tokens
    examples = LabeledTokenExamples(labels, network, seed=training.seed)
    chosen, held = split_by_group(examples.groups, training.held_out_share, training.seed)
    data: dict[str, Any] = {
        START: start.runs,
        "recordings": sorted(set(examples.groups)),
        "labels": len(examples),
    }
    learning = TokenLearning(network, training, folder, processes, progress)
    return learning.of(Subset(examples, chosen), Subset(examples, held), data, start)
