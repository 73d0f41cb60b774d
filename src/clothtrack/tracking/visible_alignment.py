"""TTO1: the visible vertices of a predicted mesh are aligned to the cloud of its frame."""

from collections.abc import Callable, Collection
from dataclasses import replace

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
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.seams import Aligner, Correction, Observe, Prediction

SUPPORT_M = 0.01
"""A vertex with a cloud point this near [m] counts as observed even where the sensor could not have
contradicted it."""

CLOUD_REACH_M = 0.1
"""Cloud points farther from every visible vertex [m] are not this cloth."""

LEAST_POINTS_PER_VERTEX = 0.1
"""With fewer cloud points per vertex there is no correction: too little is seen, and the frame's
prediction stands."""


class VisibleAlignment:
    """Aligns what is visible, and says what a pseudo-action may take hold of."""

    def __init__(
        self,
        mesh: ClothMesh,
        config: TrackerConfig,
        alignment: AlignmentConfig,
        visible: VisibilityCheck,
        *,
        table: Table | None,
        marks: Callable[[Float[np.ndarray, "vertices 3"], Observation], Marks | None],
        device: str = "cpu",
    ) -> None:
        """Prepare topology and rest lengths once.

        Args:
            mesh: the flat first mesh.
            config: what counts as observed and what is attached.
            alignment: objective and solver of the optimisation.
            visible: which vertices some camera sees.
            table: the plane that the cloth cannot pass.
            marks: where followed points of the pictures want vertices.
            device: "cpu" or "cuda:0".
        """
        self._config, self._visible, self._table = config, visible, table
        self._crossings = CrossingCheck(mesh.faces)
        self._marks = marks
        self._aligner = CloudAligner(mesh, alignment, device=device)

    def __call__(self, predicted: Prediction, observation: Observation) -> Correction | None:
        """How the predicted mesh has to move; None when there is too little cloud to tell."""
        return self.aligned(predicted.positions[0], observation)

    def sees(self, positions: Float[np.ndarray, "vertices 3"]) -> Bool[np.ndarray, " vertices"]:
        """The vertices that some camera sees when they are there [m]."""
        return self._visible(positions)

    def aligned(
        self, positions: Float[np.ndarray, "vertices 3"], observation: Observation
    ) -> Correction | None:
        """How vertices [m] have to move to meet a cloud; None when there is too little of it."""
        config = self._config
        visible = self._visible(positions)
        points = within_reach(observation.points, positions[visible], CLOUD_REACH_M)
        if len(points) < LEAST_POINTS_PER_VERTEX * len(positions):
            return None
        observed = visible & ~observation.unobservable(positions)
        alignment = self._aligner.align(
            positions,
            points,
            visible,
            trusted=observed,
            table=self._table,
            rest_height_m=config.solver.resting_height_m,
            marks=self._marks(positions, observation),
        )
        attached = visible
        if config.attach_observed_only:
            # Where silence means nothing, a vertex is observed if it found points beside it.
            unsure = np.flatnonzero(visible & ~observed)
            moved = positions[unsure] + alignment.corrections[unsure]
            attached = observed
            attached[unsure] = _supported(moved, points)
        if not config.attach_crossed:
            attached = attached & ~self._at_crossings(positions)
        losses = float(alignment.losses[0]), float(alignment.losses[-1])
        return Correction(positions, alignment.corrections, attached, losses)

    def _at_crossings(
        self, positions: Float[np.ndarray, "vertices 3"]
    ) -> Bool[np.ndarray, " vertices"]:
        """Vertices of the edges and triangles that pass through each other."""
        crossed = np.zeros(len(positions), dtype=bool)
        for part in self._crossings(positions):
            crossed[part] = True
        return crossed


def no_alignment(predicted: Prediction, observation: Observation) -> None:  # noqa: ARG001
    """The ablation without pseudo-actions: no cloud is asked, every prediction stands."""
    return


def only_at(frames: Collection[int], observe: Observe, recording: Recording) -> Observe:
    """See these frames alone: to read a picture that no part asks for costs a sixth of open loop.

    Args:
        frames: indices of the frames that are observed.
        observe: the cloud of a frame.
        recording: whose cameras see nothing at the others.
    """
    nothing = Observation(np.zeros((0, 3)), recording.cameras, {}, None, np.zeros((0, 3)), 0.0)
    return lambda frame: observe(frame) if frame.index in frames else nothing


def from_last_mesh(align: Aligner) -> Aligner:
    """The ablation without dynamics initialisation: aligned is the mesh before the roll-out."""

    def aligned(predicted: Prediction, observation: Observation) -> Correction | None:
        return align(replace(predicted, positions=predicted.started_at), observation)

    return aligned


def _supported(
    vertices: Float[np.ndarray, "vertices 3"], points: Float[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " vertices"]:
    """Vertices with a cloud point beside them."""
    if not len(vertices):
        return np.zeros(0, dtype=bool)
    # Few vertices ask: most points are far from all of them, and need no place in a tree.
    tree = cKDTree(beside(points, vertices, SUPPORT_M), balanced_tree=False)
    distance = tree.query(vertices, distance_upper_bound=SUPPORT_M)[0]
    return np.isfinite(distance)
