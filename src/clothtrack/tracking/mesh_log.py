"""Meshes of one frame after the other, in memory or in a file that has no name."""

import io
import tempfile
import weakref
from typing import IO

import numpy as np
from jaxtyping import Float32

_AT_ONCE = 64
"""So many meshes are written at once where one is repeated: an hour of rest is no array."""


class MeshLog:
    """Keeps meshes; on a disk, memory stays flat however many there are.

    The file is the system's to choose (`TMPDIR`), and goes with this object.
    """

    def __init__(self, vertices: int, *, on_disk: bool = False) -> None:
        """Begin without a mesh.

        Args:
            vertices: of every mesh.
            on_disk: keep them in a file.
        """
        self._shape = (vertices, 3)
        self._on_disk, self._count = on_disk, 0
        self._file: IO[bytes] = io.BytesIO()
        if on_disk:
            self._file = tempfile.TemporaryFile(prefix="clothtrack-")  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        """Return how many meshes there are."""
        return self._count

    def write(self, first: int, meshes: Float32[np.ndarray, "meshes vertices 3"]) -> None:
        """Put meshes [m] where others are, from this one on, or behind the last."""
        values = np.ascontiguousarray(meshes, np.float32)
        self._file.seek(first * self._bytes)
        self._file.write(values.data)
        self._count = max(self._count, first + len(values))

    def append(self, mesh: Float32[np.ndarray, "vertices 3"]) -> None:
        """Put a mesh [m] behind the last."""
        self.write(self._count, np.asarray(mesh, np.float32)[None])

    def fill(self, first: int, last: int, mesh: Float32[np.ndarray, "vertices 3"]) -> None:
        """Put the same mesh [m] into all from `first` to before `last`."""
        some = np.repeat(np.asarray(mesh, np.float32)[None], min(_AT_ONCE, last - first), axis=0)
        for start in range(first, last, _AT_ONCE):
            self.write(start, some[: last - start])

    def newest(self) -> Float32[np.ndarray, "vertices 3"]:
        """Return the last mesh [m]."""
        self._file.seek((self._count - 1) * self._bytes)
        return np.frombuffer(self._file.read(self._bytes), np.float32).reshape(self._shape)

    def meshes(self) -> Float32[np.ndarray, "meshes vertices 3"]:
        """Return all meshes [m]; those of a file are read as they are looked at."""
        shape = (self._count, *self._shape)
        if not self._on_disk or not self._count:
            self._file.seek(0)
            return np.frombuffer(bytearray(self._file.read()), np.float32).reshape(shape)
        self._file.flush()
        return np.asarray(np.memmap(self._file, np.float32, mode="c", shape=shape))

    @property
    def _bytes(self) -> int:
        return 12 * self._shape[0]
