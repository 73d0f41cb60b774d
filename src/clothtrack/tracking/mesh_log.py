"""Sequence of meshes, one per frame, in memory or in an anonymous file."""

import io
import tempfile
import weakref
from typing import IO

import numpy as np
from jaxtyping import Float32

_AT_ONCE = 64
"""Meshes per write when one is repeated, so that an hour of rest needs no large array."""


class MeshLog:
    """Store of meshes; on disk, it needs constant memory for any number of meshes.

    The system chooses the file (`TMPDIR`). It is removed together with this object.
    """

    def __init__(self, vertices: int, *, on_disk: bool = False) -> None:
        """Begin without a mesh."""
        self._shape = (vertices, 3)
        self._on_disk, self._count = on_disk, 0
        self._file: IO[bytes] = io.BytesIO()
        if on_disk:
            self._file = tempfile.TemporaryFile(prefix="clothtrack-")  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        """Return the number of meshes."""
        return self._count

    def write(self, first: int, meshes: Float32[np.ndarray, "meshes vertices 3"]) -> None:
        """Write meshes [m] from index `first` on; overwrite existing ones or extend the log."""
        values = np.ascontiguousarray(meshes, np.float32)
        self._file.seek(first * self._bytes)
        self._file.write(values.data)
        self._count = max(self._count, first + len(values))

    def append(self, mesh: Float32[np.ndarray, "vertices 3"]) -> None:
        """Append a mesh [m]."""
        self.write(self._count, np.asarray(mesh, np.float32)[None])

    def fill(self, first: int, last: int, mesh: Float32[np.ndarray, "vertices 3"]) -> None:
        """Write the same mesh [m] at all indices from `first` to before `last`."""
        some = np.repeat(np.asarray(mesh, np.float32)[None], min(_AT_ONCE, last - first), axis=0)
        for start in range(first, last, _AT_ONCE):
            self.write(start, some[: last - start])

    def newest(self) -> Float32[np.ndarray, "vertices 3"]:
        """Return the last mesh [m]."""
        self._file.seek((self._count - 1) * self._bytes)
        return np.frombuffer(self._file.read(self._bytes), np.float32).reshape(self._shape)

    def meshes(self) -> Float32[np.ndarray, "meshes vertices 3"]:
        """Return all meshes [m]; those in a file are read when accessed."""
        shape = (self._count, *self._shape)
        if not self._on_disk or not self._count:
            self._file.seek(0)
            return np.frombuffer(bytearray(self._file.read()), np.float32).reshape(shape)
        self._file.flush()
        return np.asarray(np.memmap(self._file, np.float32, mode="c", shape=shape))

    @property
    def _bytes(self) -> int:
        return 12 * self._shape[0]
