"""How long, how fast and on what a stage is trained."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Bounds, Checked, Count, Fraction, Natural, NotNegative, Positive

StageName = Literal["canonicalisation", "completion", "tokens"]
STAGES: tuple[StageName, ...] = ("canonicalisation", "completion")
"""Those of the published network; the token network has one of its own."""


@dataclass(frozen=True)
class TrainingConfig(Checked):
    """One run of the loop.

    Attributes:
        epochs: passes over the training examples, at most.
        batch_size: examples per step, over all processes.
        low_rate: learning rate of Adam, or the lowest of its cycle.
        high_rate: the highest rate of the triangular cycle; the same as `low_rate`: constant.
        rise_epochs: epochs over which the rate climbs from the lowest to the highest.
        decay: what the rate does after its rise: down and up again in a triangle (L. N. Smith,
            2017), down once over all epochs that are left, as a cosine (I. Loshchilov, F. Hutter,
            2017), or "stable": it stays, for as long as the run is given time, and falls once at
            the end (S. Hu et al., arXiv 2404.06395, Sec. 4).
        rise_examples: "stable": examples over which the rate climbs. Long enough for the moments
            of Adam, which a start from weights alone begins at zero.
        fall_examples: "stable": when above 0, the rate falls to the lowest over so many examples,
            from the step at which this is first asked for, and the run ends there.
        average_examples: examples over which the exponential average of the weights reaches back;
            the average is what is measured and kept. 0: no average.
        gradient_limit: gradients are scaled to this norm at most; 0: as they are.
        freeze_statistics: batch norms keep the statistics that they have (fine-tuning on few
            examples spoils them).
        held_out_share: share of the groups (episodes, trajectories) that selects and is never
            trained on; the paper's 9:1.
        evaluate_epochs: epochs between two measurements on the held-out examples.
        evaluate_examples: "stable": examples between two measurements; epochs are not counted.
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

    epochs: Count = 100
    batch_size: Count = 8
    low_rate: Positive = 1e-3
    high_rate: float = 1e-3
    rise_epochs: Positive = 4.0
    decay: Literal["triangle", "cosine", "stable"] = "triangle"
    rise_examples: Count = 16_000
    fall_examples: Natural = 0
    average_examples: Natural = 0
    gradient_limit: NotNegative = 0.0
    freeze_statistics: bool = False
    held_out_share: Fraction = 0.1
    evaluate_epochs: Count = 1
    evaluate_examples: Count = 20_000
    patience: Natural = 0
    old_share: Annotated[float, Bounds(least=0, below=1)] = 0.0
    log_steps: Count = 10
    save_steps: Count = 500
    bfloat16: bool = False
    workers: Natural = 0
    seed: Natural = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be trained.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        if self.low_rate > self.high_rate:
            raise InvalidConfigError(
                f"low_rate is {self.low_rate}, high_rate {self.high_rate}; it takes "
                "0 < low_rate <= high_rate"
            )

    def rate(self, step: int, steps_per_epoch: int, *, falls_from: int | None = None) -> float:
        """Return the learning rate at a step, a function of the step and nothing else.

        Args:
            step: steps done.
            steps_per_epoch: not used by a "stable" rate.
            falls_from: step from which a "stable" rate falls; None while it stays.
        """
        if self.decay == "stable":
            height = min(1.0, step * self.batch_size / self.rise_examples)
            if falls_from is not None:
                fallen = (step - falls_from) * self.batch_size / max(1, self.fall_examples)
                # 1 - sqrt loses least (A. Haegele et al., arXiv 2405.18392, Sec. 4).
                height *= 1.0 - math.sqrt(min(1.0, max(0.0, fallen)))
            return self.low_rate + (self.high_rate - self.low_rate) * height
        rise = max(1.0, self.rise_epochs * steps_per_epoch)
        if self.decay == "cosine":
            left = max(1.0, self.epochs * steps_per_epoch - rise)
            fallen = min(1.0, max(0.0, step - rise) / left)
            height = step / rise if step < rise else 0.5 * (1.0 + math.cos(math.pi * fallen))
        else:
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
            the reference's pretraining (the paper does not say). The token network is fine-tuned as
            canonicalisation is, but for "finetune_short": a rate six times as high that falls once.

    Raises:
        InvalidConfigError: there is no such preset.
    """
    if name not in TRAINING_PRESETS:
        raise InvalidConfigError(
            f"training preset is {name!r}; known are {', '.join(TRAINING_PRESETS)}"
        )
    if stage == "tokens":
        return _of_tokens(name)
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


def _of_tokens(name: str) -> TrainingConfig:
    if name.startswith("pretrain"):
        return TrainingConfig(
            batch_size=16,
            low_rate=1e-6,
            high_rate=8e-4,
            decay="stable",
            average_examples=20_000,
            gradient_limit=1.0,
            held_out_share=0.03,
            save_steps=100,
            bfloat16=True,
        )
    fine = replace(training_preset(name, "canonicalisation"), gradient_limit=1.0, bfloat16=True)
    if name == "finetune_short":
        # On real labels, places came from 97 to 37 mm; in 24 epochs at half the rate, to 69.
        return replace(
            fine, epochs=80, low_rate=1e-6, high_rate=6e-4, rise_epochs=4.0, decay="cosine"
        )
    return fine
