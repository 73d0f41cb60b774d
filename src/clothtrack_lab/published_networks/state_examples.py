"""Simulated states and pseudo-labels as examples of the published network."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.rendered_states import RenderedStates
from clothtrack.reconstruction.data.state_store import StateSet, StateShard
from clothtrack.reconstruction.training.batches import Draw
from clothtrack_lab.published_networks.canonical_frame import canonical_frame
from clothtrack_lab.published_networks.examples import (
    Example,
    ExampleConfig,
    Garment,
    draw_example,
)
from clothtrack_lab.published_networks.network_config import NetworkConfig

_ROOM = 0.98
"""Share of its category's canonical cube that a garment may fill."""


class StateExamples(RenderedStates[Garment, Example]):
    """Labeled states of simulated garments as examples of the published network.

    Args:
        sets: folders of states, all of one kind of garment.
        network: what the pictures are for.
        config: augmentation and numbers of queries.
        rendering: the cameras.
        seed: of everything random.

    Raises:
        InvalidConfigError: there is no state, or the sets are of several kinds.
        InvalidResultError: a shard is damaged.
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
        super().__init__(sets, rendering or RenderConfig(), seed)
        self.groups = [
            (number, int(self._shard(number).episodes[state])) for number, state in self._places
        ]

    def _garment_of(self, shard: StateShard, number: int) -> Garment:
        return Garment.of(shard.mesh, self.kind, self.config.winding, seed=number)

    def _drawn(
        self,
        picture: LabeledPicture,
        shard: StateShard,
        garment: Garment,
        rng: np.random.Generator,
    ) -> Example:
        del shard
        return draw_example(picture, garment, self.network, self.config, rng)

    def _fitted(self, shard: StateShard) -> StateShard:
        return _in_cube(shard)


def _in_cube(shard: StateShard) -> StateShard:
    """The states as those of a garment that its category's canonical cube has room for.

    A larger one is shown in a smaller world, as a picture of a garment of unknown size is
    (`from_picture`); folds look much alike at all sizes.
    """
    reach_m = float(np.abs(np.asarray(shard.mesh.canonical)).max())
    room_m = _ROOM * 0.5 / canonical_frame(shard.kind).scale
    if reach_m <= room_m:
        return shard
    factor = room_m / reach_m
    positions = (shard.positions * factor).astype(np.float32)
    return replace(shard, mesh=shard.mesh.scaled(factor), positions=positions)


class PseudoLabelExamples:
    """Labeled recordings as examples.

    Args:
        recordings: all of one kind.
        network: what the pictures are for.
        config: augmentation and numbers of queries.
        seed: of everything random.

    Raises:
        InvalidResultError: there is no label, or they are of several kinds.
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
        """Number of labeled pictures."""
        return len(self._pictures)

    def __getitem__(self, draw: Draw) -> Example:
        """The picture, augmented for this epoch."""
        index, epoch = draw
        rng = np.random.default_rng([self.seed, epoch, index])
        picture, labels = self._pictures[index], self._garments[index]
        return draw_example(picture, labels, self.network, self.config, rng)
