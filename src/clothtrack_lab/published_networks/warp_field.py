"""The warp field: where each place of the canonical pose is now.

Predicted as what must be added to the canonical pose (MEDOR, arXiv 2209.03287, 3.2), after the
observation has been turned into the canonical frame, so that a turned cloth is nothing to learn.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from clothtrack_lab.published_networks.completion import in_box, perceptron, sample
from clothtrack_lab.published_networks.network_config import NetworkConfig

RESIDUAL_M = 0.1
"""What an output of 1 stands for [m]."""


class WarpField(nn.Module):
    """Reads the displacement of canonical places from the completed volume.

    Args:
        config: sizes of the network.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        wide = config.decoder_hidden
        self.decoder = perceptron((config.volume_channels + 3, wide, wide, 3))
        # Before it has learned anything it says that the garment lies in its canonical pose.
        last = self.decoder[-1]
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(
        self,
        volume: Float[Tensor, "batch channels x y z"],
        queries: Float[Tensor, "batch queries 3"],
    ) -> Float[Tensor, "batch queries 3"]:
        """Displacements [m], in the frame in which the observation is aligned.

        Args:
            volume: from `Completion`.
            queries: canonical places in the unit cube.
        """
        read = sample(volume, in_box(queries, self.config))
        known = torch.cat([read, queries - 0.5], dim=-1)
        return RESIDUAL_M * self.decoder(known)
