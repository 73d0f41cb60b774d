"""Training configuration of the published network: training loops, sizes and examples."""

from dataclasses import dataclass, field, replace
from typing import Literal

from clothtrack.errors import InvalidConfigError
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack_lab.published_networks.examples import ExampleConfig
from clothtrack_lab.published_networks.network_config import NetworkConfig, preset

StageName = Literal["canonicalisation", "completion"]
STAGES: tuple[StageName, ...] = ("canonicalisation", "completion")

TRAININGS = ("pretrain", "finetune", "finetune_short", "paper")


def training_preset(name: str, stage: StageName) -> TrainingConfig:
    """Return the settings of a kind of training."""
    if name not in TRAININGS:
        raise InvalidConfigError(f"training preset is {name!r}; known are {', '.join(TRAININGS)}")
    first = stage == "canonicalisation"
    batch_size = 8 if first else 24
    if name == "pretrain":
        return TrainingConfig(epochs=100 if first else 60, batch_size=batch_size)
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


@dataclass(frozen=True)
class PublishedConfig:
    """The training configuration of the published network.

    Attributes:
        canonicalisation: training loop of the first stage.
        completion: training loop of the second stage.
        examples: augmentation of the examples, and numbers of queries.
        network: sizes of the networks to pretrain; None for those of the weights to fine-tune.
    """

    canonicalisation: TrainingConfig
    completion: TrainingConfig
    examples: ExampleConfig = field(default_factory=ExampleConfig)
    network: NetworkConfig | None = None

    @classmethod
    def preset(cls, training: str, *, network: str = "small", seed: int = 0) -> "PublishedConfig":
        """Return the settings of a kind of training for both stages.

        Args:
            training: "pretrain", "finetune", "finetune_short" or "paper" (`training_preset`).
            network: sizes to pretrain, "small".
            seed: seed of weights, order and all random draws of the examples.

        Raises:
            InvalidConfigError: there is no such training or network.
        """
        stages = {stage: replace(training_preset(training, stage), seed=seed) for stage in STAGES}
        sizes = preset(network) if training.startswith("pretrain") else None
        return cls(**stages, network=sizes)
