"""The warp field: the current position of each point of the canonical pose.

It is predicted as a displacement from the canonical pose (MEDOR, arXiv 2209.03287, 3.2), after the
observation has been rotated into the canonical frame, so that the network need not learn rotations
of the cloth.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from clothtrack_lab.published_networks.completion import in_box, perceptron, sample
from clothtrack_lab.published_networks.network_config import NetworkConfig

RESIDUAL_M = 0.1
"""Displacement for a network output of 1 [m]."""


class WarpField(nn.Module):
    """A decoder of the displacement of canonical points from the completed volume."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        wide = config.decoder_hidden
        self.decoder = perceptron((config.volume_channels + 3, wide, wide, 3))
        # The untrained network predicts the canonical pose.
        last = self.decoder[-1]
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(
        self,
        volume: Float[Tensor, "batch channels x y z"],
        queries: Float[Tensor, "batch queries 3"],
    ) -> Float[Tensor, "batch queries 3"]:
        """Return displacements [m] in the frame in which the observation is aligned."""
        read = sample(volume, in_box(queries, self.config))
        known = torch.cat([read, queries - 0.5], dim=-1)
        return RESIDUAL_M * self.decoder(known)
