"""The interface of what is trained: a module with a loss and its own measures."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn


class Stage(nn.Module, ABC):
    """A trainable module whose call returns the scalars of a batch, including "loss".

    Attributes:
        score: name of the measure that selects the best weights; lower is better.
        network: configuration of the networks, stored with the weights.
        trained: part whose parameters change and that the weights file holds.
    """

    name: str
    score: str
    unit: str = "mm"
    network: Any
    kind: str
    trained: nn.Module

    @abstractmethod
    def measure(self, batch: Any) -> Mapping[str, Tensor]:
        """Return errors against ground truth, one number per example; no gradients."""
