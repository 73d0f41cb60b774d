"""The outcome of a training, of one network or of several stages."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from clothtrack.reconstruction.training.training_run import TrainingOutcome


@dataclass(frozen=True)
class LearningOutcome:
    """Outcome of a training.

    Attributes:
        stages: outcome of each stage that was started, by name.
        model: file with the weights of all stages; None after an interrupt.
    """

    stages: Mapping[str, TrainingOutcome]
    model: Path | None
