"""How the token network is trained: its loop and its sizes."""

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
    # On real labels, places came from 97 to 37 mm; in 24 epochs at half the rate, to 69.
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
"""The loop of each kind of training: on simulated states from nothing; on pseudo-labels until it
gets no better; on the same, one rise and fall of a rate 60 times as high, minutes instead of hours
on a processor, three in ten held out, for one trajectory is too little to select by; as many epochs
as the paper fine-tunes its first network."""


@dataclass(frozen=True)
class LearningConfig:
    """How the token network is trained.

    Attributes:
        tokens: the loop.
        network: sizes of the network that is pretrained; None: those of the weights that are
            fine-tuned.
    """

    tokens: TrainingConfig = _PRETRAIN
    network: TokenNetworkConfig | None = None

    @classmethod
    def preset(cls, training: str, *, network: str = "tokens", seed: int = 0) -> "LearningConfig":
        """Return the settings of a kind of training.

        Args:
            training: one of `TRAININGS`.
            network: "tokens", the only size that has a name.
            seed: of weights, order and everything random in the examples.

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
