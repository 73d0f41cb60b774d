"""Trains the token network on packed states: pictures are rendered where the network is.

The loop is that of any training (`training/training_loop.py`). Its examples are only the numbers of
states; a whole batch is rendered at once, on the device, when it is put together.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from clothtrack.errors import InvalidConfigError
from clothtrack.files.progress import Progress
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.learning_outcome import LearningOutcome
from clothtrack.reconstruction.tokens.packed_states import PackedStates, read_pack
from clothtrack.reconstruction.tokens.token_learning import TokenLearning, split_by_digest
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_pictures import PIXELS, TokenPictures
from clothtrack.reconstruction.tokens.token_stage import TokenBatch
from clothtrack.reconstruction.training.batches import Draw, Subset
from clothtrack.reconstruction.training.checkpoint import START, load_weights
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig


class _PackedDraws:
    """States by their numbers: what a batch of them shows is rendered by `rendered`.

    Args:
        states: packed.
        pictures: renders them.
    """

    def __init__(self, states: PackedStates, pictures: TokenPictures) -> None:
        self.pictures = pictures
        self.groups = states.groups

    def __len__(self) -> int:
        """Number of states."""
        return len(self.groups)

    def __getitem__(self, draw: Draw) -> Draw:
        """The draw itself."""
        return draw

    def rendered(self, draws: Sequence[Draw]) -> TokenBatch:
        """Render the states of a batch, the same for the same draws."""
        chosen = torch.tensor([index for index, _ in draws])
        return self.pictures.batch(chosen, [number for draw in draws for number in draw])


def pretrain_packed(
    packs: Sequence[Path],
    network: TokenNetworkConfig,
    config: TrainingConfig,
    folder: Path,
    *,
    rendering: RenderConfig | None = None,
    asked: int = PIXELS,
    start: Path | None = None,
    hours: float | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> LearningOutcome:
    """Train on packed states; a second call goes on where the first one stopped.

    The same garments are held out as in a training on the folders of the states.

    Args:
        packs: files of `write_pack`.
        network: sizes of the network.
        config: how.
        folder: gets progress, scalars and `model.safetensors`.
        rendering: the cameras.
        asked: pixels per picture that are asked for their name.
        start: weights to begin with (`grown`).
        hours: of wall time after which the training pauses; None for no limit.
        processes: the device; pictures are rendered on it, by one process.
        progress: called after every step.

    Returns:
        How it ended, and the file with the best weights.

    Raises:
        InvalidConfigError: the states are too few, or there are several processes.
        InvalidResultError: packs, progress or weights are damaged or of another training.
        StorageError: when the disk refuses.
    """
    alone = processes or Processes()
    if alone.count > 1:
        raise InvalidConfigError(
            f"{alone.count} processes were started; packed states are rendered and learned from by "
            "one: start it without torchrun"
        )
    read = [read_pack(path) for path in packs]
    states = PackedStates.joined([one for one, _ in read])
    cameras = rendering or RenderConfig()
    pictures = TokenPictures(
        states, network, rendering=cameras, device=alone.device, asked=asked, seed=config.seed
    )
    draws = _PackedDraws(states, pictures)
    training, held = split_by_digest(draws.groups, config.held_out_share)
    data: dict[str, Any] = {
        "states": len(states),
        "sets": [provenance for _, provenance in read],
        "rendering": cameras.as_dict(),
        "asked": asked,
    }
    weights = None
    if start is not None:
        weights = load_weights(start)
        data[START] = weights.runs
    learning = TokenLearning(network, config, folder, alone, progress, hours, draws.rendered)
    return learning.of(Subset(draws, training), Subset(draws, held), data, weights)
