"""TTO1: align the visible vertices of a predicted mesh to the cloud of its frame."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.alignment.aligner import AlignmentConfig, CloudAligner, Marks
from clothtrack.alignment.cloud_distance import beside, within_reach
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import CrossingCheck
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording, Table
from clothtrack.tracking.protocols import Correction, Observe, Prediction

SUPPORT_M = 0.01
"""A vertex with a cloud point this near [m] counts as observed even in a region where the sensor
could not have contradicted it."""

CLOUD_REACH_M = 0.1
"""Cloud points farther than this [m] from every visible vertex do not belong to this cloth."""

_LEAST_POINTS_PER_VERTEX = 0.1
"""With fewer cloud points per vertex too little is seen: the prediction is kept uncorrected."""


@dataclass(frozen=True, eq=False)
class VisibleAlignment:
    """Alignment of the visible vertices, and choice of the vertices that a pseudo-action attaches.

    Attributes:
        table: the plane that the cloth cannot pass.
        rest_height_m: height of a vertex above the table when the cloth lies on it [m].
        anchors: returns the vertex targets given by feature tracks.
        observed_only: attach only vertices that the sensor could have contradicted; the paper
            attaches every visible vertex.
        uncrossed_only: leave vertices free where the predicted cloth intersects itself; the paper
            attaches them. Contact can undo a crossing, but not against a pull.
    """

    mesh: ClothMesh
    alignment: AlignmentConfig
    visible: VisibilityCheck
    table: Table | None
    rest_height_m: float
    anchors: Callable[[Float[np.ndarray, "vertices 3"], Observation], Marks | None]
    observed_only: bool = True
    uncrossed_only: bool = True
    device: str = "cpu"

    @cached_property
    def _aligner(self) -> CloudAligner:
        return CloudAligner(self.mesh, self.alignment, device=self.device)

    @cached_property
    def _crossings(self) -> CrossingCheck:
        return CrossingCheck(self.mesh.faces)

    def __call__(self, predicted: Prediction, observation: Observation) -> Correction | None:
        """Return the correction of the predicted mesh; None if the cloud is too small."""
        return self.aligned(predicted.positions[0], observation)

    def aligned(
        self, positions: Float[np.ndarray, "vertices 3"], observation: Observation
    ) -> Correction | None:
        """Return the correction of vertices [m] to a cloud; None if the cloud is too small."""
        visible = self.visible(positions)
        points = within_reach(observation.points, positions[visible], CLOUD_REACH_M)
        if len(points) < _LEAST_POINTS_PER_VERTEX * len(positions):
            return None
        observed = visible & ~observation.unobservable(positions)
        alignment = self._aligner.align(
            positions,
            points,
            visible,
            trusted=observed,
            table=self.table,
            rest_height_m=self.rest_height_m,
            marks=self.anchors(positions, observation),
        )
        attached = visible
        if self.observed_only:
            # In unobservable regions a visible vertex is observed only if a cloud point is near.
            unsure = np.flatnonzero(visible & ~observed)
            moved = positions[unsure] + alignment.corrections[unsure]
            attached = observed
            attached[unsure] = _supported(moved, points)
        if self.uncrossed_only:
            attached = attached & ~self._at_crossings(positions)
        losses = float(alignment.losses[0]), float(alignment.losses[-1])
        return Correction(positions, alignment.corrections, attached, losses)

    def _at_crossings(
        self, positions: Float[np.ndarray, "vertices 3"]
    ) -> Bool[np.ndarray, " vertices"]:
        """Return the vertices of edges and triangles that pass through each other."""
        crossed = np.zeros(len(positions), dtype=bool)
        for part in self._crossings(positions):
            crossed[part] = True
        return crossed


def no_alignment(predicted: Prediction, observation: Observation) -> None:  # noqa: ARG001
    """Return None: the ablation without pseudo-actions, which keeps every prediction."""
    return


def only_at(frames: Collection[int], observe: Observe, recording: Recording) -> Observe:
    """Return an observer of only these frames; all others give an empty observation.

    Reading unused pictures costs a sixth of an open-loop run.
    """
    nothing = Observation(np.zeros((0, 3)), recording.cameras, {}, None, np.zeros((0, 3)), 0.0)
    return lambda frame: observe(frame) if frame.index in frames else nothing


def _supported(
    vertices: Float[np.ndarray, "vertices 3"], points: Float[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " vertices"]:
    """Return which vertices have a cloud point nearby."""
    if not len(vertices):
        return np.zeros(0, dtype=bool)
    # There are few vertices and most points are far from all of them: keep those out of the tree.
    tree = cKDTree(beside(points, vertices, SUPPORT_M), balanced_tree=False)
    distance = tree.query(vertices, distance_upper_bound=SUPPORT_M)[0]
    return np.isfinite(distance)
