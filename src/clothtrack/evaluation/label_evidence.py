"""Observable evidence of a label's quality: how well the mesh fits its cloud and behaves as cloth.

A label is the mesh at the end of an action, after the final alignment. Nothing here uses the
truth. `clothtrack.evaluation.label_quality` combines the evidence into one number.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from clothtrack.alignment.silhouette import silhouette_gap
from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.local_misfit import LocalMisfit, local_misfit
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.recordings.point_cloud import Observation, observe, thin
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

_CLOUD_SPACING_M = 0.004
"""Point spacing of the clouds used for distances [m], as in tracking."""


@dataclass(frozen=True, eq=False)
class Label:
    """Mesh that may be used for training.

    Attributes:
        frame: its frame of the recording.
        vertices: vertices after the final alignment [m].
        before: vertices before the final alignment [m].
    """

    frame: int
    vertices: Float[np.ndarray, "vertices 3"]
    before: Float[np.ndarray, "vertices 3"]


@dataclass(frozen=True)
class LabelEvidence:
    """Evidence against a label; larger values are worse, and none needs the truth.

    Attributes:
        silhouette_gap: 1 minus intersection over union of the mesh's and the cloth's silhouettes,
            without parts that were unobservable or cut away from the cloud.
        cloud_gap_m: mean distance of the cloud's points to the mesh [m].
        mesh_gap_m: 90th percentile of the visible vertices' distance to the cloud [m]; vertices in
            unobservable regions do not count.
        edge_strain_p95: 95th percentile of the edges' absolute relative change of length.
        crossing_rate: edges that pass through a triangle, per 1,000 edges.
        final_shift_m: mean shift of the vertices by the final alignment [m].
        travelled_m: mean path length of the vertices from label to label, up to this one [m].
        share_hidden: share of the vertices that no camera sees.
        action: number of the action, from 1; it matters because errors accumulate.
        misfit: local misfit between mesh and observation; None if not stored.
    """

    silhouette_gap: float
    cloud_gap_m: float
    mesh_gap_m: float
    edge_strain_p95: float
    crossing_rate: float
    final_shift_m: float
    travelled_m: float
    share_hidden: float
    action: int
    misfit: LocalMisfit | None = field(default=None, compare=False, repr=False)

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name."""
        return {name: getattr(self, name) for name in EVIDENCE_NAMES}


EVIDENCE_NAMES = tuple(one.name for one in fields(LabelEvidence) if one.name != "misfit")


def labels_of(tracked: TrackedTrajectory) -> tuple[Label, ...]:
    """Return the labels of a tracked trajectory, one per action."""
    return tuple(
        Label(
            action.last_frame,
            np.asarray(action.positions_after_final_alignment, np.float64),
            np.asarray(action.positions_before_final_alignment, np.float64),
        )
        for action in tracked.actions
    )


def label_evidence(
    mesh: ClothMesh,
    labels: Sequence[Label],
    recording: Recording,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
) -> tuple[LabelEvidence, ...]:
    """Return the evidence about every label of one trajectory."""
    evidence = []
    traveled, previous = 0.0, np.asarray(mesh.vertices, np.float64)
    for number, label in enumerate(labels, 1):
        if label.frame >= len(recording.frames):
            raise InvalidResultError(
                f"a label belongs to frame {label.frame}, but {recording.folder} has "
                f"{len(recording.frames)} frames; give the recording that it was tracked from"
            )
        traveled += mean_distance(label.vertices, previous)
        previous = label.vertices
        dense, cloud = _seen(recording, label.frame, segmenter)
        evidence.append(
            mesh_evidence(
                mesh, label, dense, cloud, travelled_m=traveled, action=number, device=device
            )
        )
    return tuple(evidence)


def misfit_at(
    mesh: ClothMesh,
    vertices: Float[np.ndarray, "vertices 3"],
    recording: Recording,
    frame: int,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
) -> LocalMisfit:
    """Return the local misfit between a mesh and the observation of a frame.

    Args:
        vertices: positions of its vertices [m].
    """
    dense, cloud = _seen(recording, frame, segmenter)
    away = distance_to_mesh(cloud, vertices, mesh.faces) if len(cloud) else np.zeros(0)
    return local_misfit(mesh, vertices, dense, cloud, away, device=device)


def _seen(
    recording: Recording, frame: int, segmenter: Segmenter | None
) -> tuple[Observation, Float[np.ndarray, "points 3"]]:
    """Return the dense cloud of a frame, and the thinned one [m]."""
    dense = observe(recording, recording.frames[frame], segmenter, spacing_m=None)
    return dense, thin(dense.points, _CLOUD_SPACING_M)


def mesh_evidence(
    mesh: ClothMesh,
    label: Label,
    dense: Observation,
    cloud: Float[np.ndarray, "points 3"],
    *,
    travelled_m: float,
    action: int,
    device: str = "cpu",
) -> LabelEvidence:
    """Return the evidence about one mesh.

    Args:
        cloud: the same cloud thinned [m].
        travelled_m: mean path length of the vertices so far [m].
    """
    away = distance_to_mesh(cloud, label.vertices, mesh.faces) if len(cloud) else np.zeros(0)
    seen = visible_vertices(label.vertices, mesh.faces, dense.cameras, device=device)
    judged = seen & ~dense.unobservable(label.vertices)
    return LabelEvidence(
        silhouette_gap=silhouette_gap(mesh, label.vertices, dense, device=device),
        cloud_gap_m=float(away.mean()) if len(away) else float("nan"),
        mesh_gap_m=_far_quantile(cloud, label.vertices[judged]),
        edge_strain_p95=_edge_strain_p95(mesh, label.vertices),
        crossing_rate=1e3 * crossings(label.vertices, mesh.faces) / len(mesh.edges),
        final_shift_m=mean_distance(label.vertices, label.before),
        travelled_m=travelled_m,
        share_hidden=float(1.0 - seen.mean()),
        action=action,
        misfit=local_misfit(mesh, label.vertices, dense, cloud, away, device=device),
    )


def _far_quantile(
    cloud: Float[np.ndarray, "points 3"], vertices: Float[np.ndarray, "judged 3"]
) -> float:
    if not (len(vertices) and len(cloud)):
        return float("nan")
    return float(np.percentile(cKDTree(cloud).query(vertices)[0], 90))


def _edge_strain_p95(mesh: ClothMesh, vertices: Float[np.ndarray, "vertices 3"]) -> float:
    ends = vertices[mesh.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(np.percentile(np.abs(lengths / mesh.edge_lengths - 1.0), 95))


def mean_distance(a: Float[np.ndarray, "points 3"], b: Float[np.ndarray, "points 3"]) -> float:
    """Return the mean distance between corresponding points [m]."""
    return float(np.linalg.norm(a - b, axis=1).mean())
