"""States of many garments in one small file, for a machine that only trains.

Vertices are whole tenths of a millimeter, predicted from one another (`state_codec.py`) and
compressed: about 2.5 bytes each. Beside the states lies what the token network is told of their
garments, so that training needs neither the folders of states nor what reads them. The file is
safetensors, with a SHA-256 over all of it.
"""

import json
import lzma
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int, UInt8
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.array_digest import DIGEST
from clothtrack.files.atomic_write import atomic_file
from clothtrack.reconstruction.data.batch_rows import joined_rows
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.state_codec import Prediction, coded, decoded, prediction
from clothtrack.reconstruction.training.checkpoint import weights_digest

FORMAT = "clothtrack-packed-states"
VERSION = "1"

STEP_M = 1e-4
"""Positions are whole multiples of this [m]: 0.05 mm off at most, where sensors are 1 mm off."""

_LARGEST_M = 32_767 * STEP_M
"""Half of the longest axis that a state can have [m]."""

_MOST_VERTICES = 32_768
"""Vertices that a face can name in 16 bits."""


@dataclass(frozen=True, eq=False)
class PackedStates:
    """States of garments, one after the other.

    Attributes:
        positions: vertices of all states from the middle of the state, in steps of `STEP_M`.
        first: where the vertices of each state begin.
        garment: the garment of each state.
        low, high: least and largest coordinates of each state [m].
        vertices, faces: how many each garment has.
        corners: vertices of all faces of all garments; `GarmentTokens` has the rest.
        vertex_tokens, vertex_shares: of all vertices of all garments.
        features, token_corners, token_blend, labelings, is_labeling, mirror, neighbors: of the
            tokens; the corners are those of the face that a token lies on.
        size_m, layers: of each garment.
        digest: the first 8 hexadecimal digits of each garment's digest, as a number.
    """

    positions: Int[Tensor, "all_vertices 3"]
    first: Int[Tensor, " states"]
    garment: Int[Tensor, " states"]
    low: Float[Tensor, "states 3"]
    high: Float[Tensor, "states 3"]
    vertices: Int[Tensor, " garments"]
    faces: Int[Tensor, " garments"]
    corners: Int[Tensor, "all_faces 3"]
    vertex_tokens: UInt8[Tensor, "garment_vertices shares"]
    vertex_shares: Float[Tensor, "garment_vertices shares"]
    features: Float[Tensor, "garments tokens features"]
    token_corners: Int[Tensor, "garments tokens 3"]
    token_blend: Float[Tensor, "garments tokens 3"]
    labelings: UInt8[Tensor, "garments labelings tokens"]
    is_labeling: Bool[Tensor, "garments labelings"]
    mirror: UInt8[Tensor, "garments tokens"]
    neighbors: UInt8[Tensor, "garments tokens neighbors"]
    size_m: Float[Tensor, " garments"]
    layers: Int[Tensor, " garments"]
    digest: Int[Tensor, " garments"]

    def __len__(self) -> int:
        """Number of states."""
        return len(self.first)

    @classmethod
    def of(
        cls,
        faces: Int[np.ndarray, "faces 3"],
        garment: GarmentTokens,
        positions: Float32[np.ndarray, "states vertices 3"],
        digest: str,
    ) -> "PackedStates":
        """Pack the states of one garment.

        Args:
            faces: of its mesh.
            garment: its tokens.
            positions: vertices of each state in the world [m], z up, the table at z = 0.
            digest: of the garment and its states, in hexadecimal digits.

        Raises:
            InvalidConfigError: it has more vertices, or is larger, than fits.
        """
        states, vertices = positions.shape[:2]
        low, high = positions.min(axis=1), positions.max(axis=1)
        largest_m = 0.5 * float((high - low).max())
        if vertices > _MOST_VERTICES or not largest_m < _LARGEST_M:
            raise InvalidConfigError(
                f"a garment has {vertices} vertices and is up to {2.0 * largest_m:.2f} m long (at "
                f"most {_MOST_VERTICES} and {2.0 * _LARGEST_M:.1f} m can be packed); simulate a "
                "coarser or smaller one"
            )
        parts = np.rint((positions - 0.5 * (low + high)[:, None]) / STEP_M)
        arrays = {
            "positions": parts.reshape(-1, 3).astype(np.int16),
            "first": np.arange(states) * vertices,
            "garment": np.zeros(states, np.int32),
            "low": low.astype(np.float32),
            "high": high.astype(np.float32),
            "vertices": np.array([vertices], np.int32),
            "faces": np.array([len(faces)], np.int32),
            "corners": faces.astype(np.int16),
            "vertex_tokens": garment.vertex_tokens.astype(np.uint8),
            "vertex_shares": garment.vertex_shares.astype(np.float16),
            "features": garment.features[None],
            "token_corners": faces[garment.face].astype(np.int16)[None],
            "token_blend": garment.blend.astype(np.float32)[None],
            "labelings": garment.labelings.astype(np.uint8)[None],
            "is_labeling": garment.is_labeling[None],
            "mirror": garment.mirror.astype(np.uint8)[None],
            "neighbors": garment.neighbors.astype(np.uint8)[None],
            "size_m": np.array([garment.size_m], np.float32),
            "layers": np.array([garment.layers], np.int32),
            "digest": np.array([int(digest[:8], 16)]),
        }
        return cls(**{name: torch.from_numpy(values.copy()) for name, values in arrays.items()})

    @classmethod
    def joined(cls, packs: Sequence["PackedStates"]) -> "PackedStates":
        """All states of several packs, in their order.

        Raises:
            InvalidConfigError: there is none.
        """
        if not packs:
            raise InvalidConfigError("no states were given; name at least one pack")
        moved, begin, garments = [], 0, 0
        for one in packs:
            moved.append(replace(one, first=one.first + begin, garment=one.garment + garments))
            begin, garments = begin + len(one.positions), garments + len(one.vertices)
        return joined_rows(moved)

    @property
    def groups(self) -> list[str]:
        """The digest of each state's garment, shortened: by it a garment is held out as a whole."""
        named = [f"{one:08x}" for one in self.digest.tolist()]
        return [named[one] for one in self.garment.tolist()]

    def state(self, number: int) -> Float[Tensor, "vertices 3"]:
        """Vertices of one state in the world [m]."""
        count = int(self.vertices[int(self.garment[number])])
        begin = int(self.first[number])
        middle = 0.5 * (self.low[number] + self.high[number])
        return self.positions[begin : begin + count].float() * STEP_M + middle


def write_pack(path: Path, states: PackedStates, provenance: dict[str, Any]) -> None:
    """Write states to one file, whole or not at all.

    Args:
        path: the file.
        states: what goes into it.
        provenance: where they came from, as plain values.

    Raises:
        StorageError: the disk refuses.
    """
    arrays = {one.name: getattr(states, one.name).numpy() for one in fields(states)}
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "provenance": json.dumps(provenance),
        "arrays": json.dumps({name: [one.dtype.str, one.shape] for name, one in arrays.items()}),
    }
    compressed = {name: _compressed(content) for name, content in _contents(states).items()}
    tensors = {
        name: torch.frombuffer(bytearray(content), dtype=torch.uint8)
        for name, content in compressed.items()
    }
    metadata[DIGEST] = weights_digest(tensors, metadata)
    with atomic_file(path) as temporary:
        save_file(tensors, temporary, metadata)


def read_pack(path: Path) -> tuple[PackedStates, dict[str, Any]]:
    """Read states and their provenance, as `write_pack` has written them; nothing is executed.

    Raises:
        InvalidResultError: it is missing, damaged, of another version or something else.
    """
    remedy = "pack the states again, or fetch an undamaged copy"
    if not path.is_file():
        raise InvalidResultError(f"{path}: there is no such file; check the name")
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise InvalidResultError(f"{path}: not a whole safetensors file ({error}); {remedy}") from (
            error
        )
    found = metadata.get("format"), metadata.get("version")
    if found != (FORMAT, VERSION):
        raise InvalidResultError(
            f"{path}: format and version are {found[0]!r:.80}, {found[1]!r:.80}, expected "
            f"{FORMAT!r}, {VERSION!r}; give states that were packed with this version"
        )
    if weights_digest(tensors, metadata) != metadata.get(DIGEST):
        raise InvalidResultError(
            f"{path}: is damaged (its SHA-256 differs from the one it was written with); {remedy}"
        )
    try:
        arrays = {
            name: _array(tensors[name].numpy().tobytes(), *described)
            for name, described in json.loads(metadata["arrays"]).items()
        }
        states = PackedStates(**{name: torch.from_numpy(one) for name, one in arrays.items()})
        positions = _decoded(states)
    except (KeyError, ValueError, TypeError, IndexError, lzma.LZMAError) as error:
        raise InvalidResultError(f"{path}: its content does not fit ({error}); {remedy}") from error
    provenance = {**json.loads(metadata["provenance"]), DIGEST: metadata[DIGEST]}
    return replace(states, positions=positions), provenance


def packed_bytes(states: PackedStates) -> int:
    """Return about how many bytes a file of these states has."""
    return sum(len(_compressed(content)) for content in _contents(states).values())


def in_files(packs: Iterable[PackedStates], most_bytes: int) -> Iterator[PackedStates]:
    """Packs of garments, joined to as few as a limit of their size allows.

    Args:
        packs: of one garment each, or of a few.
        most_bytes: of each joined pack.
    """
    waiting: list[PackedStates] = []
    size = 0
    for one in packs:
        own = packed_bytes(one)
        if waiting and size + own > most_bytes:
            yield PackedStates.joined(waiting)
            waiting, size = [], 0
        waiting.append(one)
        size += own
    if waiting:
        yield PackedStates.joined(waiting)


def _contents(states: PackedStates) -> dict[str, bytes]:
    """The bytes of every array, positions as what their prediction leaves."""
    arrays = {one.name: getattr(states, one.name).numpy() for one in fields(states)}
    parts = [coded(shown.numpy(), how) for shown, how in _by_garment(states)]
    return {
        name: np.concatenate(parts).tobytes() if name == "positions" else values.tobytes()
        for name, values in arrays.items()
    }


def _by_garment(
    states: PackedStates,
) -> Iterator[tuple[Int[Tensor, "states vertices 3"], Prediction]]:
    """Yield the positions of each garment's states, and how they are predicted."""
    begin = corner = 0
    counts = torch.bincount(states.garment.long(), minlength=len(states.vertices)).tolist()
    sizes = zip(counts, states.vertices.tolist(), states.faces.tolist(), strict=True)
    for count, vertices, faces in sizes:
        how = prediction(states.corners[corner : corner + faces].numpy().astype(np.int64), vertices)
        shown = states.positions[begin : begin + count * vertices]
        yield shown.view(count, vertices, 3), how
        begin, corner = begin + count * vertices, corner + faces


def _decoded(states: PackedStates) -> Int[Tensor, "all_vertices 3"]:
    """The positions, from an array of their size that holds what their prediction leaves."""
    parts = [
        torch.from_numpy(decoded(shown.numpy().reshape(-1).view(np.uint8), how)).view(-1, 3)
        for shown, how in _by_garment(states)
    ]
    return torch.cat(parts)


def _compressed(content: bytes) -> bytes:
    return lzma.compress(content, preset=6)


def _array(content: bytes, dtype: str, shape: Sequence[int]) -> np.ndarray:
    """An array from its compressed bytes; no more of them than its shape asks for.

    Raises:
        ValueError: they are too few or too many.
    """
    size = int(np.dtype(dtype).itemsize * np.prod(shape))
    # One byte more, to see that there is none.
    whole = lzma.LZMADecompressor().decompress(content, max_length=size + 1)
    if len(whole) != size:
        raise ValueError(f"an array of {size} bytes has other ones")
    return np.frombuffer(whole, dtype).reshape(shape).copy()
