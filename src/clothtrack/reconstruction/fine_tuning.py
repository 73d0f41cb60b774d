"""Fine-tuning on pseudo-labels (paper, Sec. III-C), of whichever network the weights are of."""

from collections.abc import Sequence
from pathlib import Path

from clothtrack.files.progress import Progress
from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.learning_config import LearningConfig
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.tokens.token_learning import KIND
from clothtrack.reconstruction.tokens.token_training import finetune_tokens
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.two_stages import finetune_two_stages


def finetune(
    start: Path,
    labels: Sequence[LabelledRecording],
    config: LearningConfig,
    folder: Path,
    *,
    old: Sequence[StateSet] = (),
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train a network further on pseudo-labels, by the loops of its own stages.

    Args:
        start: weights to begin with.
        labels: labelled recordings; some are held out to select by.
        config: how; `old_share` of its stages mixes in old states.
        folder: gets progress, scalars and `model.safetensors`.
        old: states of the old cloth, against forgetting.
        processes: who trains together.
        progress: called after every step.

    Raises:
        InvalidConfigError: there are too few labels, or old states are asked for and not given.
        InvalidResultError: weights, states or progress are damaged or do not belong together.
        StorageError: when the disk refuses.
    """
    weights = load_weights(start)
    train = finetune_tokens if weights.kind == KIND else finetune_two_stages
    return train(weights, labels, config, folder, old=old, processes=processes, progress=progress)
