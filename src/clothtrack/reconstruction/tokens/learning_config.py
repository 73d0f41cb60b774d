"""Training settings of the token network: its loop and its sizes."""

from dataclasses import dataclass, replace

from clothtrack.errors import InvalidConfigError
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.reconstruction.training.training_config import TrainingConfig

_PRETRAIN = TrainingConfig(
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
_FINETUNE = TrainingConfig(
    epochs=1000,
    low_rate=1e-6,
    high_rate=1e-5,
    gradient_limit=1.0,
    freeze_statistics=True,
    evaluate_epochs=5,
    patience=20,
    bfloat16=True,
)
TRAININGS = {
    "pretrain": _PRETRAIN,
    "finetune": _FINETUNE,
    # On real labels it reduced the position error from 97 to 37 mm; 24 epochs at half the rate
    # reduced it to 69 mm.
    "finetune_short": replace(
        _FINETUNE,
        epochs=80,
        high_rate=6e-4,
        decay="cosine",
        held_out_share=0.3,
        patience=0,
    ),
    "paper": replace(_FINETUNE, patience=0),
}
"""Loop settings of each kind of training. "pretrain" uses simulated states, from scratch.
"finetune" uses pseudo-labels until there is no improvement. "finetune_short" uses the same with one
rise and fall of a rate 60 times as high, which takes minutes instead of hours on a CPU; it holds
out three in ten, because one trajectory is too little for selection. "paper" takes as many epochs
as the paper fine-tunes its first network."""


@dataclass(frozen=True)
class LearningConfig:
    """Training settings of the token network.

    Attributes:
        tokens: settings of the loop.
        network: sizes of the network to pretrain; None: those of the weights to fine-tune.
    """

    tokens: TrainingConfig = _PRETRAIN
    network: TokenNetworkConfig | None = None

    @classmethod
    def preset(cls, training: str, *, network: str = "tokens", seed: int = 0) -> "LearningConfig":
        """Return the settings of a kind of training.

        Args:
            training: one of `TRAININGS`.
            network: "tokens", the only named size.
            seed: seed of weights, order and all randomness in the examples.

        Raises:
            InvalidConfigError: there is no such training.
        """
        del network
        if training not in TRAININGS:
            raise InvalidConfigError(
                f"training preset is {training!r}; known are {', '.join(TRAININGS)}"
            )
        sizes = TokenNetworkConfig() if training == "pretrain" else None
        return cls(replace(TRAININGS[training], seed=seed), sizes)
