"""How long, how fast and on what a stage is trained."""

from dataclasses import dataclass
from typing import Literal

from clothtrack.errors import InvalidConfigError

StageName = Literal["canonicalisation", "completion"]
STAGES: tuple[StageName, ...] = ("canonicalisation", "completion")


@dataclass(frozen=True)
class TrainingConfig:
    """One run of the loop.

    Attributes:
        epochs: passes over the training examples, at most.
        batch_size: examples per step, over all processes.
        low_rate: learning rate of Adam, or the lowest of its cycle.
        high_rate: the highest rate of the triangular cycle; the same as `low_rate`: constant.
        rise_epochs: epochs over which the rate climbs from the lowest to the highest.
        freeze_statistics: batch norms keep the statistics that they have (fine-tuning on few
            examples spoils them).
        held_out_share: share of the groups (episodes, trajectories) that selects and is never
            trained on; the paper's 9:1.
        evaluate_epochs: epochs between two measurements on the held-out examples.
        patience: measurements without an improvement after which training stops; 0: never.
        old_share: probability that an example is replaced by one of the old cloth, against
            forgetting (fine-tuning).
        log_steps: steps between two lines of training scalars.
        save_steps: steps between two saves of the progress; it is saved with every measurement
            too.
        bfloat16: compute in half precision where it is safe; only for processors that have it.
        workers: processes that make examples; 0 makes them in the loop.
        seed: of weights, order and everything random in the examples.
    """

    epochs: int = 100
    batch_size: int = 8
    low_rate: float = 1e-3
    high_rate: float = 1e-3
    rise_epochs: float = 4.0
    freeze_statistics: bool = False
    held_out_share: float = 0.1
    evaluate_epochs: int = 1
    patience: int = 0
    old_share: float = 0.0
    log_steps: int = 10
    save_steps: int = 500
    bfloat16: bool = False
    workers: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be trained.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        for name in ("epochs", "batch_size", "evaluate_epochs", "log_steps", "save_steps"):
            if getattr(self, name) < 1:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; it must be at least 1")
        for name in ("patience", "workers", "seed"):
            if getattr(self, name) < 0:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; it must be 0 or more")
        if not 0.0 < self.low_rate <= self.high_rate:
            raise InvalidConfigError(
                f"low_rate is {self.low_rate}, high_rate {self.high_rate}; it takes "
                "0 < low_rate <= high_rate"
            )
        if not self.rise_epochs > 0.0:
            raise InvalidConfigError(f"rise_epochs is {self.rise_epochs}; it must be positive")
        if not 0.0 < self.held_out_share < 1.0:
            raise InvalidConfigError(
                f"held_out_share is {self.held_out_share}; it must be between 0 and 1"
            )
        if not 0.0 <= self.old_share < 1.0:
            raise InvalidConfigError(f"old_share is {self.old_share}; it must be in 0..1, not 1")

    def rate(self, step: int, steps_per_epoch: int) -> float:
        """Learning rate at a step: constant, or up and down in a triangle (L. N. Smith, 2017).

        It is a function of the step and nothing else, so that nothing of it needs saving.
        """
        rise = max(1.0, self.rise_epochs * steps_per_epoch)
        phase = (step / rise) % 2.0
        height = phase if phase <= 1.0 else 2.0 - phase
        return self.low_rate + (self.high_rate - self.low_rate) * height


TRAINING_PRESETS = ("pretrain", "pretrain_reference", "finetune", "finetune_short", "paper")


def training_preset(name: str, stage: StageName) -> TrainingConfig:
    """The settings of a kind of training.

    Args:
        name: "pretrain": the `small` network from nothing; "pretrain_reference": the `reference`
            network, as MEDOR was trained (arXiv 2209.03287: 1e-4, 350 and 150 epochs);
            "finetune": on pseudo-labels until it gets no better; "finetune_short": on the same, one
            rise and fall of a rate 10 times as high, minutes instead of hours on a processor, and
            three in ten held out, for one trajectory is too little to select by;
            "paper": fine-tuning as published, 1,000 and 2,000 epochs.
        stage: what is trained; batches are 8 for canonicalisation and 24 for completion, as in
            the reference's pretraining (the paper does not say).

    Raises:
        InvalidConfigError: there is no such preset.
    """
    if name not in TRAINING_PRESETS:
        raise InvalidConfigError(
            f"training preset is {name!r}; known are {', '.join(TRAINING_PRESETS)}"
        )
    first = stage == "canonicalisation"
    batch_size = 8 if first else 24
    if name == "pretrain":
        return TrainingConfig(epochs=100 if first else 60, batch_size=batch_size)
    if name == "pretrain_reference":
        epochs = 350 if first else 150
        return TrainingConfig(epochs=epochs, batch_size=batch_size, low_rate=1e-4, high_rate=1e-4)
    if name == "finetune_short":
        epochs = 60 if first else 30
        return TrainingConfig(
            epochs=epochs,
            low_rate=1e-5,
            high_rate=1e-4,
            rise_epochs=epochs / 2,
            freeze_statistics=True,
            held_out_share=0.3,
            evaluate_epochs=5,
        )
    return TrainingConfig(
        epochs=1000 if first else 2000,
        batch_size=batch_size,
        low_rate=1e-6,
        high_rate=1e-5,
        freeze_statistics=True,
        evaluate_epochs=5,
        patience=0 if name == "paper" else 20,
    )
