"""The normal matrix of an isometric fit: a fast sum and factorization of several parts."""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu


class NormalMatrix:
    """Normal equations of one mesh, with a fixed sparsity pattern for repeated factorization."""

    def __init__(
        self, along: sparse.csr_array, bends: sparse.csr_array, faces: Int[np.ndarray, "faces 3"]
    ) -> None:
        count = along.shape[1]
        parts = [(along.T @ along).tocoo(), (bends.T @ bends).tocoo()]
        rows = np.concatenate([*(part.row for part in parts), np.arange(count)])
        columns = np.concatenate([*(part.col for part in parts), np.arange(count)])
        keys = np.unique(columns.astype(np.int64) * count + rows)
        self._count = count
        self._indices = (keys % count).astype(np.int32)
        self._starts = np.searchsorted(keys, np.arange(count + 1) * np.int64(count))
        self._starts = self._starts.astype(np.int32)
        self._lengths, self._bending = (
            self._spread(keys, part.row, part.col, part.data) for part in parts
        )
        self._diagonal = np.searchsorted(keys, np.arange(count) * np.int64(count + 1))
        pairs = faces[:, np.repeat(np.arange(3), 3)], faces[:, np.tile(np.arange(3), 3)]
        self._of_faces = np.searchsorted(keys, pairs[1].astype(np.int64) * count + pairs[0])

    def _spread(
        self, keys: np.ndarray, rows: np.ndarray, columns: np.ndarray, values: np.ndarray
    ) -> Float[np.ndarray, " entries"]:
        place = np.searchsorted(keys, columns.astype(np.int64) * self._count + rows)
        return np.bincount(place, values, len(keys))

    def factorized(
        self,
        edge: float,
        bend: float,
        diagonal: Float[np.ndarray, " vertices"],
        corners: Float[np.ndarray, "faces 9"] | None = None,
    ) -> SuperLU:
        """Return the factorization of the weighted sum of all parts."""
        entries = edge * self._lengths + bend * self._bending
        if corners is not None:
            entries += np.bincount(self._of_faces.ravel(), corners.ravel(), len(entries))
        entries[self._diagonal] += diagonal
        matrix = sparse.csc_array(
            (entries, self._indices, self._starts), (self._count, self._count)
        )
        # The matrix is symmetric and positive definite, so no off-diagonal pivots are needed.
        return splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )  # fmt: skip
