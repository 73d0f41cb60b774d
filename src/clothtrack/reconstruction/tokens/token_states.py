"""States of many garments as tensors, with the token network's input for each garment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from clothtrack.errors import InvalidConfigError
from clothtrack.reconstruction.data.batch_rows import joined_rows
from clothtrack.reconstruction.data.state_store import (
    StateSet,
    StateShard,
    read_shard,
    shard_digest,
)
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens


@dataclass(frozen=True, eq=False)
class TokenStates:
    """States of garments, concatenated.

    Attributes:
        positions: vertices of all states in the world [m], z up, the table at z = 0.
        low, high: least and largest coordinates of each state [m].
        vertices, faces: number of vertices and faces of each garment.
        corners: vertices of all faces of all garments. For the fields below see `GarmentTokens`.
        vertex_tokens, vertex_shares: tokens and shares of all vertices of all garments.
        features, token_corners, token_blend, labelings, is_labeling, mirror, neighbors: fields of
            the tokens; the corners are those of the face that a token lies on.
        size_m, layers: size and number of layers of each garment.
    """

    positions: Float[Tensor, "all_vertices 3"]
    first: Int[Tensor, " states"]
    garment: Int[Tensor, " states"]
    low: Float[Tensor, "states 3"]
    high: Float[Tensor, "states 3"]
    vertices: Int[Tensor, " garments"]
    faces: Int[Tensor, " garments"]
    corners: Int[Tensor, "all_faces 3"]
    vertex_tokens: Int[Tensor, "garment_vertices shares"]
    vertex_shares: Float[Tensor, "garment_vertices shares"]
    features: Float[Tensor, "garments tokens features"]
    token_corners: Int[Tensor, "garments tokens 3"]
    token_blend: Float[Tensor, "garments tokens 3"]
    labelings: Int[Tensor, "garments labelings tokens"]
    is_labeling: Bool[Tensor, "garments labelings"]
    mirror: Int[Tensor, "garments tokens"]
    neighbors: Int[Tensor, "garments tokens neighbors"]
    size_m: Float[Tensor, " garments"]
    layers: Int[Tensor, " garments"]

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.first)

    @classmethod
    def of(cls, shard: StateShard) -> "TokenStates":
        """Return the states of one garment."""
        garment, positions = GarmentTokens.of(shard.mesh), shard.positions
        states, vertices = positions.shape[:2]
        faces = np.asarray(shard.mesh.faces)
        arrays = {
            "positions": positions.reshape(-1, 3),
            "first": np.arange(states) * vertices,
            "garment": np.zeros(states, np.int64),
            "low": positions.min(axis=1),
            "high": positions.max(axis=1),
            "vertices": np.array([vertices]),
            "faces": np.array([len(faces)]),
            "corners": faces,
            "vertex_tokens": garment.vertex_tokens,
            "vertex_shares": garment.vertex_shares,
            "features": garment.features[None],
            "token_corners": faces[garment.face][None],
            "token_blend": garment.blend[None],
            "labelings": garment.labelings[None],
            "is_labeling": garment.is_labeling[None],
            "mirror": garment.mirror[None],
            "neighbors": garment.neighbors[None],
            "size_m": np.array([garment.size_m]),
            "layers": np.array([garment.layers]),
        }
        return cls(**{name: _tensor(values) for name, values in arrays.items()})

    @classmethod
    def joined(cls, parts: Sequence["TokenStates"]) -> "TokenStates":
        """Return all states of several garments, in order."""
        moved, begin, garments = [], 0, 0
        for one in parts:
            moved.append(replace(one, first=one.first + begin, garment=one.garment + garments))
            begin, garments = begin + len(one.positions), garments + len(one.vertices)
        return joined_rows(moved)


def read_token_states(sets: Sequence[StateSet]) -> tuple[TokenStates, list[str]]:
    """Read folders of states."""
    parts: list[TokenStates] = []
    digests: list[str] = []
    for path in (path for one in sets for path in one.shards):
        parts.append(TokenStates.of(read_shard(path)))
        digests += [shard_digest(path)] * len(parts[-1])
    if not digests:
        raise InvalidConfigError("there are no states; make some with clothtrack simulate")
    return TokenStates.joined(parts), digests


def _tensor(values: np.ndarray) -> Tensor:
    """Return the array as a tensor, floats in single precision and integers of 64 bits."""
    kind = {"f": np.float32, "i": np.int64, "u": np.int64}.get(values.dtype.kind)
    return torch.from_numpy(np.array(values, dtype=kind))
