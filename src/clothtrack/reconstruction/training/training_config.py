"""The settings of a training run: duration, learning rate, batches and evaluation."""

import math
from dataclasses import dataclass
from typing import Literal

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count, Fraction, Natural, NotNegative, Positive


@dataclass(frozen=True)
class TrainingConfig(Checked):
    """Settings of one run of the training loop.

    Attributes:
        epochs: maximum number of passes over the training examples.
        batch_size: examples per step, over all processes.
        low_rate: learning rate of Adam, or the lowest of its schedule.
        high_rate: highest learning rate of the schedule; if equal to `low_rate`, it is constant.
        rise_epochs: epochs over which the rate rises from the lowest to the highest.
        decay: schedule after the rise: "triangle", "cosine" or "stable". "triangle" falls and rises
            again (L. N. Smith, 2017); "cosine" falls once over all remaining epochs (I. Loshchilov,
            F. Hutter, 2017); "stable" stays constant for as long as the run is given time and falls
            once at the end (S. Hu et al., arXiv 2404.06395, Sec. 4).
        rise_examples: "stable": examples over which the rate rises. This is long enough for the
            moments of Adam, which are zero when a run starts from weights alone.
        fall_examples: "stable": if above 0, the rate falls to the lowest over this many examples,
            from the step at which this is first set, and the run ends there.
        average_examples: time constant [examples] of the exponential average of the weights; the
            average is measured and saved. 0: no average.
        gradient_limit: maximum gradient norm, enforced by scaling; 0: no limit.
        freeze_statistics: batch norms keep their statistics (fine-tuning on few examples spoils
            them).
        held_out_share: share of the groups (episodes, trajectories) that selects the best weights
            and is never trained on; the paper's 9:1.
        evaluate_epochs: epochs between two measurements on the held-out examples.
        evaluate_examples: "stable": examples between two measurements; epochs are not counted.
        patience: measurements without an improvement after which training stops; 0: never.
        log_steps: steps between two lines of training scalars.
        save_steps: steps between two saves of the progress, which every measurement saves too.
        bfloat16: compute in half precision where it is safe; only for processors that support it.
        workers: number of processes that make examples; 0 makes them in the loop.
        seed: seed of weights, order and all randomness in the examples.
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
    log_steps: Count = 10
    save_steps: Count = 500
    bfloat16: bool = False
    workers: Natural = 0
    seed: Natural = 0

    def __post_init__(self) -> None:
        """Reject invalid settings.

        Raises:
            InvalidConfigError: a field is out of bounds; states the field, its value and the limit.
        """
        super().__post_init__()
        if self.low_rate > self.high_rate:
            raise InvalidConfigError(
                f"low_rate is {self.low_rate}, high_rate {self.high_rate}; it takes "
                "0 < low_rate <= high_rate"
            )

    def rate(self, step: int, steps_per_epoch: int, *, falls_from: int | None = None) -> float:
        """Return the learning rate at a step.

        Args:
            step: number of completed steps.
            steps_per_epoch: steps per epoch; unused by a "stable" rate.
            falls_from: step from which a "stable" rate falls; None while it is constant.
        """
        if self.decay == "stable":
            height = min(1.0, step * self.batch_size / self.rise_examples)
            if falls_from is not None:
                fallen = (step - falls_from) * self.batch_size / max(1, self.fall_examples)
                # 1 - sqrt gives the lowest loss (A. Haegele et al., arXiv 2405.18392, Sec. 4).
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
