"""What comes of a training, of one network or of several stages."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from clothtrack.reconstruction.training.training_run import TrainingOutcome


@dataclass(frozen=True)
class LearningOutcome:
    """What came of a training.

    Attributes:
        stages: how each stage that was begun ended, by name.
        model: the file with the weights of all stages; None after an interrupt.
    """

    stages: Mapping[str, TrainingOutcome]
    model: Path | None
