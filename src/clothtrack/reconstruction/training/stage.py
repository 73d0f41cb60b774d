"""What is trained: a module with a loss, and measures of its own."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn


class Stage(nn.Module, ABC):
    """What is trained: a module whose call gives the scalars of a batch, "loss" among them.

    Attributes:
        name: of the stage.
        score: the measure that selects; lower is better.
        unit: of that measure.
        network: configuration of the networks, stored with the weights.
        kind: the garment, stored with the weights.
        trained: the part whose parameters change, and which the weights file holds.
    """

    name: str
    score: str
    unit: str = "mm"
    network: Any
    kind: str
    trained: nn.Module

    @abstractmethod
    def measure(self, batch: Any) -> Mapping[str, Tensor]:
        """Errors against the truth, one number per example; no gradients."""
