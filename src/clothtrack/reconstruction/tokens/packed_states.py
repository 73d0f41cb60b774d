"""States of many garments in one small file, for a machine that only trains.

A state is 6 bytes per vertex: 16-bit numbers between the ends of its longest axis, which are
0.015 mm apart for a garment of 1 m (half precision: 0.24 mm). Beside the states lies what
the token network is told of their garments, so that training needs neither the folders of states
nor what reads them. The file is safetensors, with a SHA-256 over all of it.
"""

import json
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
from clothtrack.reconstruction.training.checkpoint import weights_digest

FORMAT = "clothtrack-packed-states"
VERSION = "1"

LARGEST = 32_767
"""Largest 16-bit number: half of a state's longest axis."""

MOST_VERTICES = 32_768
"""Vertices that a face can name in 16 bits."""


@dataclass(frozen=True, eq=False)
class PackedStates:
    """States of garments, one after the other.

    Attributes:
        positions: vertices of all states, from the middle of the state, as parts of its scale.
        first: where the vertices of each state begin.
        garment: the garment of each state.
        low, high: least and largest coordinates of each state [m].
        vertices, faces: how many each garment has.
        corners: vertices of all faces of all garments; `GarmentTokens` has the rest.
        vertex_tokens, vertex_shares: of all vertices of all garments.
        features, token_corners, token_blend, labellings, is_labelling, mirror, neighbours: of the
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
    labellings: UInt8[Tensor, "garments labellings tokens"]
    is_labelling: Bool[Tensor, "garments labellings"]
    mirror: UInt8[Tensor, "garments tokens"]
    neighbours: UInt8[Tensor, "garments tokens neighbours"]
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
            InvalidConfigError: it has more vertices than fit.
        """
        states, vertices = positions.shape[:2]
        if vertices > MOST_VERTICES:
            raise InvalidConfigError(
                f"a garment has {vertices} vertices (at most {MOST_VERTICES} can be packed); "
                "simulate it with fewer"
            )
        low, high = positions.min(axis=1), positions.max(axis=1)
        middle, scale = 0.5 * (low + high), 0.5 * (high - low).max(axis=1)
        parts = (positions - middle[:, None]) / np.maximum(scale, 1e-9)[:, None, None]
        parts = np.rint(parts * LARGEST).clip(-LARGEST, LARGEST)
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
            "labellings": garment.labellings.astype(np.uint8)[None],
            "is_labelling": garment.is_labelling[None],
            "mirror": garment.mirror.astype(np.uint8)[None],
            "neighbours": garment.neighbours.astype(np.uint8)[None],
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

    def bytes(self) -> int:
        """Size of the arrays."""
        return sum(getattr(self, field.name).nbytes for field in fields(self))

    @property
    def groups(self) -> list[str]:
        """The digest of each state's garment, shortened: by it a garment is held out as a whole."""
        named = [f"{one:08x}" for one in self.digest.tolist()]
        return [named[one] for one in self.garment.tolist()]

    def state(self, number: int) -> Float[Tensor, "vertices 3"]:
        """Vertices of one state in the world [m]."""
        count = int(self.vertices[int(self.garment[number])])
        begin = int(self.first[number])
        low, high = self.low[number], self.high[number]
        scale = 0.5 * (high - low).max() / LARGEST
        return self.positions[begin : begin + count].float() * scale + 0.5 * (low + high)


def write_pack(path: Path, states: PackedStates, provenance: dict[str, Any]) -> None:
    """Write states to one file, whole or not at all.

    Args:
        path: the file.
        states: what goes into it.
        provenance: where they came from, as plain values.

    Raises:
        StorageError: the disk refuses.
    """
    tensors = {one.name: getattr(states, one.name).contiguous() for one in fields(states)}
    metadata = {"format": FORMAT, "version": VERSION, "provenance": json.dumps(provenance)}
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
    return PackedStates(**tensors), {**json.loads(metadata["provenance"]), DIGEST: metadata[DIGEST]}


def in_files(packs: Iterable[PackedStates], most_bytes: int) -> Iterator[PackedStates]:
    """Packs of garments, joined to as few as a limit of their size allows.

    Args:
        packs: of one garment each, or of a few.
        most_bytes: of each joined pack.
    """
    waiting: list[PackedStates] = []
    size = 0
    for one in packs:
        if waiting and size + one.bytes() > most_bytes:
            yield PackedStates.joined(waiting)
            waiting, size = [], 0
        waiting.append(one)
        size += one.bytes()
    if waiting:
        yield PackedStates.joined(waiting)
