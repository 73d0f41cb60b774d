"""Everything that a training depends on, but for the network."""

from dataclasses import dataclass, field, replace

from clothtrack.reconstruction.data.examples import ExampleConfig
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.training.training_config import (
    STAGES,
    TrainingConfig,
    training_preset,
)


@dataclass(frozen=True)
class LearningConfig:
    """Everything that a training depends on, but for the network.

    Attributes:
        canonicalisation: the loop of the published network's first stage.
        completion: the loop of its second stage.
        tokens: the loop of the token network.
        examples: augmentation of the published network's examples, and numbers of queries.
        rendering: the cameras that see simulated states.
    """

    canonicalisation: TrainingConfig = field(
        default_factory=lambda: training_preset("pretrain", "canonicalisation")
    )
    completion: TrainingConfig = field(
        default_factory=lambda: training_preset("pretrain", "completion")
    )
    tokens: TrainingConfig = field(default_factory=lambda: training_preset("pretrain", "tokens"))
    examples: ExampleConfig = field(default_factory=ExampleConfig)
    rendering: RenderConfig = field(default_factory=RenderConfig)

    @classmethod
    def preset(cls, name: str, *, seed: int = 0) -> "LearningConfig":
        """The settings of one of `TRAINING_PRESETS` for all stages.

        Raises:
            InvalidConfigError: there is no such preset.
        """
        stages = {
            stage: replace(training_preset(name, stage), seed=seed) for stage in (*STAGES, "tokens")
        }
        return cls(**stages)

    def mixing(self, old_share: float) -> "LearningConfig":
        """The same with a share of the examples replaced by old states."""
        return replace(
            self,
            canonicalisation=replace(self.canonicalisation, old_share=old_share),
            completion=replace(self.completion, old_share=old_share),
            tokens=replace(self.tokens, old_share=old_share),
        )
