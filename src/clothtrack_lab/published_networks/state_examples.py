"""Simulated states and pseudo-labels as examples of the published network."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clothtrack.errors import InvalidConfigError, InvalidRecordingError, InvalidResultError
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.state_store import StateSet, StateShard, read_shard
from clothtrack.reconstruction.training.batches import Draw
from clothtrack_lab.published_networks.canonical_frame import canonical_frame
from clothtrack_lab.published_networks.examples import (
    Example,
    ExampleConfig,
    Garment,
    draw_example,
)
from clothtrack_lab.published_networks.network_config import NetworkConfig
from clothtrack_lab.published_networks.rendered_state import render

logger = logging.getLogger(__name__)

_ATTEMPTS, _STATES_TRIED = 8, 4
"""Number of renderings per state, and of states, before an example is given up."""

_ROOM = 0.98
"""Largest share of its category's canonical cube that a garment may fill."""


class StateExamples:
    """The labeled states of simulated garments as examples for the published network.

    Each example is a function of index, epoch and seed. Shards are read when the dataset is made,
    and again in each process that makes examples.

    Args:
        sets: folders of states, all of one kind of garment.
        network: configuration of the network that takes the pictures.
    """

    def __init__(
        self,
        sets: Sequence[StateSet],
        network: NetworkConfig,
        config: ExampleConfig | None = None,
        *,
        rendering: RenderConfig | None = None,
        seed: int = 0,
    ) -> None:
        kinds = sorted({states.kind for states in sets})
        if len(kinds) != 1:
            raise InvalidConfigError(
                f"states of {', '.join(kinds) or 'no garment'} were given; a network is trained "
                "for one kind: give folders of states of that kind"
            )
        self.kind = kinds[0]
        self.network = network
        self.config = config or ExampleConfig()
        self.rendering = rendering or RenderConfig()
        self.seed = seed
        self._paths = [path for states in sets for path in states.shards]
        self._shards: dict[int, StateShard] = {}
        self._garments: dict[int, Garment] = {}
        self._places = [
            (number, state)
            for number in range(len(self._paths))
            for state in range(len(self._shard(number).positions))
        ]
        self.groups = [
            (number, int(self._shard(number).episodes[state])) for number, state in self._places
        ]

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self._places)

    def __getitem__(self, draw: Draw) -> Example:
        """Return the state, rendered and augmented for this epoch.

        A camera may measure too little cloth for the network, most often of a narrow cloth that
        hangs behind a hand. Then the state is rendered again, and finally another state is used.
        """
        index, epoch = draw
        rng = np.random.default_rng([self.seed, epoch, index])
        failure = None
        for _ in range(_STATES_TRIED):
            number, state = self._places[index]
            shard, garment = self._shard(number), self._garment(number)
            positions = shard.positions[state].astype(np.float64)
            for _ in range(_ATTEMPTS):
                picture = render(positions, shard.mesh, self.rendering, rng)
                try:
                    return draw_example(picture, garment, self.network, self.config, rng)
                except InvalidRecordingError as error:
                    failure = f"{self._paths[number]}, state {state}: {error}"
            logger.info("rendered %d times; another state is taken: %s", _ATTEMPTS, failure)
            index = int(rng.integers(len(self)))
        raise InvalidRecordingError(str(failure))

    def _garment(self, number: int) -> Garment:
        if number not in self._garments:
            mesh = self._shard(number).mesh
            self._garments[number] = Garment.of(mesh, self.kind, self.config.winding, seed=number)
        return self._garments[number]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the shards, because each process reads its own."""
        return {**self.__dict__, "_shards": {}, "_garments": {}}

    def _shard(self, number: int) -> StateShard:
        if number not in self._shards:
            self._shards[number] = _in_cube(read_shard(self._paths[number]))
        return self._shards[number]


def _in_cube(shard: StateShard) -> StateShard:
    """Return the states, scaled down if their garment does not fit its category's canonical cube.

    The scaling is that of pictures of garments of unknown size (`from_picture`); folds look much
    alike at all sizes.
    """
    reach_m = float(np.abs(np.asarray(shard.mesh.canonical)).max())
    room_m = _ROOM * 0.5 / canonical_frame(shard.kind).scale
    if reach_m <= room_m:
        return shard
    factor = room_m / reach_m
    positions = (shard.positions * factor).astype(np.float32)
    return replace(shard, mesh=shard.mesh.scaled(factor), positions=positions)


class PseudoLabelExamples:
    """The labeled pictures of recordings as examples.

    Args:
        network: configuration of the network that takes the pictures.
    """

    def __init__(
        self,
        recordings: Sequence[LabeledRecording],
        network: NetworkConfig,
        config: ExampleConfig | None = None,
        *,
        seed: int = 0,
    ) -> None:
        kinds = sorted({one.kind for one in recordings})
        if len(kinds) != 1:
            raise InvalidResultError(
                f"labels of {', '.join(kinds) or 'no garment'} were given; a network is trained "
                "for one kind: give labels of that kind"
            )
        self.kind = kinds[0]
        self.network = network
        self.config = config or ExampleConfig()
        self.seed = seed
        self.groups: list[str] = []
        self._pictures: list[LabeledPicture] = []
        self._garments: list[Garment] = []
        for number, one in enumerate(recordings):
            labels = Garment.of(one.mesh, one.kind, self.config.winding, seed=number)
            self._pictures += one.pictures
            self._garments += [labels] * len(one.pictures)
            self.groups += [one.name] * len(one.pictures)

    def __len__(self) -> int:
        """Return the number of labeled pictures."""
        return len(self._pictures)

    def __getitem__(self, draw: Draw) -> Example:
        """Return the picture, augmented for this epoch."""
        index, epoch = draw
        rng = np.random.default_rng([self.seed, epoch, index])
        picture, labels = self._pictures[index], self._garments[index]
        return draw_example(picture, labels, self.network, self.config, rng)
