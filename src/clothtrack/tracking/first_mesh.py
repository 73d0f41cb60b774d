"""The mesh that tracking starts from: the recording's template, or a garment fitted to the cloth.

A reconstruction network will take this place; until then a flat towel or T-shirt is laid on the
first cloud, its size measured from the cloud when the recording does not state it. Depth alone
cannot tell a shirt's front from its back nor one corner of a towel from another: the front is
taken to face up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording, Table
from clothtrack.simulation.garments import garment

FITTED_KINDS = ("towel", "tshirt")


@dataclass(frozen=True)
class FirstMeshConfig:
    """How a first mesh is made when the recording has no template.

    Attributes:
        vertex_count: about how many vertices the mesh gets.
        resting_height_m: height of its lowest vertices above the table [m].
        tolerance_m: precision of the fit [m].
    """

    vertex_count: int = 1000
    resting_height_m: float = 0.0015
    tolerance_m: float = 2e-4


def first_mesh(
    recording: Recording, observation: Observation, config: FirstMeshConfig
) -> ClothMesh:
    """The recording's template, or a flat garment fitted to the first cloud.

    Args:
        recording: says what the cloth is and where the table is.
        observation: the cloud of the first frame, flat cloth.
        config: size of the mesh.

    Returns:
        The flat cloth in the world frame [m].

    Raises:
        InvalidRecordingError: when there is no template and nothing to fit one with.
    """
    if recording.cloth.template is not None:
        return recording.cloth.template
    if recording.cloth.kind not in FITTED_KINDS:
        raise InvalidRecordingError(
            f"{recording.folder}: cloth.kind is {recording.cloth.kind!r} and there is no template; "
            f"give cloth.template, or a kind that can be fitted: {', '.join(FITTED_KINDS)}"
        )
    if recording.table is None:
        raise InvalidRecordingError(
            f"{recording.folder}: no table and no template; a cloth in the air needs cloth.template"
        )
    if len(observation.points) < 100:
        raise InvalidRecordingError(
            f"{recording.folder}: the first cloud has {len(observation.points)} points, a fit "
            "needs at least 100; check the mask of frame 0 with: clothtrack inspect"
        )
    return _fitted(recording, recording.table, observation.points, config)


def _fitted(
    recording: Recording,
    table: Table,
    points: Float[np.ndarray, "points 3"],
    config: FirstMeshConfig,
) -> ClothMesh:
    axes = _plane_axes(table)
    flat = (points - table.point) @ axes[:2].T
    kind, stated = recording.cloth.kind, recording.cloth.size_m
    (center, extent, angle_deg) = cv2.minAreaRect(flat.astype(np.float32))
    best: tuple[float, np.ndarray, Sequence[float]] = (np.inf, np.zeros(5), (0.0, 0.0))
    for quarter in range(4):
        size = stated or (extent if quarter % 2 == 0 else extent[::-1])
        coarse = garment(kind, vertex_count=500, size_m=size).vertices[:, :2]
        start = np.array([*center, np.deg2rad(angle_deg + 90.0 * quarter), 0.0, 0.0])
        fit = minimize(
            _Misfit(coarse, flat, scale_fixed=stated is not None),
            start,
            method="Nelder-Mead",
            options={
                "initial_simplex": start + np.vstack([np.zeros(5), np.diag(_STEPS)]),
                "xatol": config.tolerance_m,
                "fatol": 1e-8,
                "maxiter": 600,
            },
        )
        if fit.fun < best[0]:
            best = (fit.fun, fit.x, size)
    _, (x, y, angle, *stretch), size = best
    scale = (1.0, 1.0) if stated else tuple(np.exp(stretch))
    size_m = (float(size[0] * scale[0]), float(size[1] * scale[1]))
    mesh = garment(kind, vertex_count=config.vertex_count, size_m=size_m)
    placed = mesh.vertices.astype(np.float64).copy()
    placed[:, :2] = _rotated(placed[:, :2], angle) + (x, y)
    placed[:, 2] += config.resting_height_m - placed[:, 2].min()
    return mesh.with_vertices(table.point + placed @ axes)


_STEPS = (0.02, 0.02, 0.15, 0.08, 0.08)
"""First steps of the fit: place [m], angle [rad], logarithm of the two scales."""


class _Misfit:
    """Two-way mean squared distance in the table plane between an outline's mesh and the cloud."""

    def __init__(
        self,
        mesh: Float[np.ndarray, "vertices 2"],
        cloud: Float[np.ndarray, "points 2"],
        *,
        scale_fixed: bool,
    ) -> None:
        chosen = np.linspace(0, len(cloud) - 1, min(len(cloud), 1500)).astype(int)
        self._mesh, self._cloud, self._scale_fixed = mesh, cloud[chosen], scale_fixed
        self._tree = cKDTree(cloud)

    def __call__(self, variables: Float[np.ndarray, " 5"]) -> float:
        x, y, angle, *stretch = variables
        mesh = self._mesh if self._scale_fixed else self._mesh * np.exp(stretch)
        placed = _rotated(mesh, angle) + (x, y)
        to_cloud = self._tree.query(placed)[0]
        to_mesh = cKDTree(placed).query(self._cloud)[0]
        return float(np.mean(to_cloud**2) + np.mean(to_mesh**2))


def _rotated(points: Float[np.ndarray, "points 2"], angle: float) -> Float[np.ndarray, "points 2"]:
    cosine, sine = np.cos(angle), np.sin(angle)
    return points @ np.array([[cosine, sine], [-sine, cosine]])


def _plane_axes(table: Table) -> Float[np.ndarray, "3 3"]:
    """Rows: two directions in the table and its normal, as close to the world's axes as can be."""
    normal = table.normal / np.linalg.norm(table.normal)
    first = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    if np.linalg.norm(first) < 1e-3:
        first = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first), normal])
