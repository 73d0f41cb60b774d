"""The interface of a real data set in Table 2: pictures, labels and scores."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float
from shared.bench_measures import Row

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

KIND = "towel"

Answer = tuple[ClothMesh | None, ClothMesh | None]
"""A mesh, and whose edges are its rest lengths; None where the network makes none."""

Ask = Callable[[int], Answer]


class Cloth(Protocol):
    """One recording of real cloth for training or testing.

    Attributes:
        size_m: width and length of the flat cloth [m].
    """

    name: str
    folder: Path
    size_m: tuple[float, float]
    frames: Sequence[int]

    def picture(self, frame: int) -> DepthInput:
        """Return the network's input."""
        ...

    def labeled(self, tracked: TrackedTrajectory) -> LabeledRecording:
        """Return every frame, labeled by a tracker."""
        ...

    def simulated(self, simulated: TrackedTrajectory) -> LabeledRecording:
        """Return the same frames of a simulated cloth, recorded like the real one."""
        ...

    def tracked_mesh(self, tracked: TrackedTrajectory) -> Ask:
        """Return the tracker's mesh by frame, as a network would have answered."""
        ...

    def judged(
        self, frame: int, mesh: ClothMesh, rest: ClothMesh, tracked: TrackedTrajectory
    ) -> Row:
        """Return the measures of a frame's mesh, given rest lengths and the default tracker."""
        ...


def corners(mesh: ClothMesh) -> Float[np.ndarray, "4 3"]:
    """Return a towel's corners in the world [m]: its outermost vertices along both diagonals."""
    flat = np.asarray(mesh.canonical, np.float64)[:, :2]
    flat = flat - 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    return mesh.vertices[np.argmax(flat @ signs.T, axis=0)].astype(np.float64)
