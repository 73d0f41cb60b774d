"""Test-time fine-tuning of a reconstructed mesh to the picture that it was made from.

The terms are those of the network that the paper builds on (MEDOR, arXiv 2209.03287, Sec. IV-C):
distance of cloud points to visible vertices (Chamfer), distance of observed points to the mesh
points with their canonical coordinates (observation consistency), nothing under the table, and
optionally a Laplacian of the mesh and the length of its edges. Consistency is quadratic and solved
directly. The other terms use the tracker's own alignment. If the flat garment is known, the cloth
solver carries out the correction, so that layers keep their sides and edges their lengths.
"""

import logging
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32
from scipy import sparse
from scipy.sparse.linalg import splu

from clothtrack.alignment.aligner import AlignmentConfig, CloudAligner
from clothtrack.errors import InvalidConfigError, InvalidMeshError, SimulationDivergedError
from clothtrack.files.bounds import Checked, Count, Fraction, NotNegative, Positive
from clothtrack.geometry.chamfer import two_way
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.reconstruction.from_picture import Refinement
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Table
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import SETTLE_IN_S, SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment
from clothtrack_lab.published_networks.template_fit import CLOTH

logger = logging.getLogger(__name__)

_LIFT_M = 0.05


ALIGNMENT = AlignmentConfig(iterations=50)
"""Chamfer, table and edge length terms of each round; two rounds of 50 steps are the reference's
100."""

ROLL_S = 0.1
"""Time over which the solver carries out a correction [s]; short, so that gravity has little
effect."""

_OFF_MESH_M = 0.02
"""Distance of a canonical coordinate from the mesh at which its weight is 1 / e [m]."""

VISIBILITY_WIDTH = 320
"""Width of the z-buffer that decides visibility [pixels]."""

VISIBILITY_TOLERANCE_M = 0.003
"""Distance behind the z-buffer's surface up to which a vertex is visible [m]; less than the
distance of two layers."""


@dataclass(frozen=True)
class RefinementConfig(Checked):
    """The configuration of fine-tuning a reconstructed mesh.

    Attributes:
        rounds: number of corrections, each starting from the result of the one before.
        consistency_rounds: number of first rounds that begin with observation consistency; the
            reference drops it after half of its iterations.
        consistency_weight: weight of observation consistency (the reference: 10); 0 leaves it out.
        rigidity_weight: weight of differences of displacements along edges in its solution, as in
            the alignment that follows (the paper: 10).
        outlier_m: distance of an observed point from its position on the mesh at which its weight
            is a quarter [m], because its canonical coordinate is wrong (S. Geman, D. McClure,
            1987).
        strength: strength of the pull on visible vertices while the solver carries out a
            correction.
    """

    rounds: Count = 2
    consistency_rounds: int = 1
    consistency_weight: NotNegative = 10.0
    rigidity_weight: NotNegative = 10.0
    outlier_m: Positive = 0.02
    strength: Fraction = 0.999

    def __post_init__(self) -> None:
        """Refuse values that contradict each other.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        if self.consistency_weight > 0.0 and not self.rigidity_weight > 0.0:
            raise InvalidConfigError(
                "refinement.rigidity_weight is 0: nothing says where hidden vertices are to go; "
                "give more than 0, or consistency_weight 0"
            )


class Refiner:
    """A fine-tuner of one reconstructed mesh to its observation.

    Args:
        mesh: reconstruction in the world [m]; its canonical coordinates [m], if any, are in the
            convention of the observed ones.
        observation: cloud and the cameras that saw it.
        rest: flat garment at rest with the mesh's vertices; None if it is not known. Then edges
            keep the lengths of the reconstruction, and vertices are displaced directly.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        observation: Observation,
        config: RefinementConfig,
        *,
        rest: ClothMesh | None = None,
        table: Table | None = None,
        device: str = "cpu",
    ) -> None:
        if rest is not None and not np.array_equal(rest.faces, mesh.faces):
            raise InvalidMeshError(
                f"the flat garment has {rest.vertex_count} vertices and {len(rest.faces)} faces, "
                f"the mesh {mesh.vertex_count} and {len(mesh.faces)}; give the one that the mesh "
                "was made from"
            )
        self._mesh, self._observation, self._config = mesh, observation, config
        self._table = table
        self._solver_config = SolverConfig(table=table)
        cameras = tuple(one.resized(VISIBILITY_WIDTH) for one in observation.cameras)
        self._visible = VisibilityCheck(
            mesh.faces, cameras, tolerance_m=VISIBILITY_TOLERANCE_M, device=device
        )
        self._aligner = CloudAligner(rest or mesh, ALIGNMENT, device=device)
        self._dynamics = None
        if rest is not None:
            self._dynamics = self._laid_out(rest, device)

    def refine(self, seen: SeenPoints | None = None) -> Refinement:
        """Correct the mesh, and keep the result nearest to the cloud."""
        config = self._config
        positions = self._mesh.vertices.astype(np.float64)
        tried, scores = [positions], [self._score(positions)]
        for number in range(config.rounds):
            wanted = positions
            consistent = number < config.consistency_rounds and config.consistency_weight > 0.0
            if seen is not None and consistent:
                wanted = wanted + consistent_displacement(
                    self._mesh.with_vertices(wanted), seen, config
                )
            visible = self._visible(wanted)
            alignment = self._aligner.align(
                wanted,
                self._observation.points,
                visible,
                trusted=visible & ~self._observation.unobservable(wanted),
                table=self._table,
                rest_height_m=self._solver_config.resting_height_m,
            )
            wanted = wanted + alignment.corrections
            carried = self._carried_out(positions, wanted, visible)
            if carried is None:
                logger.warning("round %d of the fine-tuning diverges; it is left out", number + 1)
                break
            positions = carried
            tried.append(positions)
            scores.append(self._score(positions))
        chosen = int(np.argmin(np.where(np.isfinite(scores), scores, np.inf)))
        return Refinement(tried[chosen], tuple(scores), chosen)

    def _score(self, positions: Float[np.ndarray, "vertices 3"]) -> float:
        visible = self._visible(positions)
        if not visible.any() or not len(self._observation.points):
            return float("nan")
        return two_way(positions[visible], self._observation.points)

    def _laid_out(self, rest: ClothMesh, device: str) -> ClothDynamics:
        """Return dynamics of the garment at rest above the table, with its layers' sides stored."""
        point = np.zeros(3) if self._table is None else self._table.point
        above = rest.vertices - rest.vertices[:, 2].min() * np.array([0.0, 0.0, 1.0])
        flat = rest.with_vertices(above + point + (0.0, 0.0, _LIFT_M))
        solver = ClothSolver(flat, self._solver_config, parameters=CLOTH, device=device)
        solver.step(SETTLE_IN_S)
        return ClothDynamics(solver, velocity_kept=0.0)

    def _carried_out(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        wanted: Float[np.ndarray, "vertices 3"],
        visible: Bool[np.ndarray, " vertices"],
    ) -> Float[np.ndarray, "vertices 3"] | None:
        """Return the vertices after visible ones are pulled; None if the cloth diverges."""
        if self._dynamics is None:
            return wanted if np.isfinite(wanted).all() else None
        solver = self._dynamics.solver
        # Hidden vertices start at their corrected positions and then follow the cloth.
        start = np.where(visible[:, None], positions, wanted)
        solver.place(start)
        solver.set_velocities(np.zeros_like(start, dtype=np.float32))
        strength = np.where(visible, self._config.strength, 0.0).astype(np.float32)
        pull = Attachment(wanted[None].astype(np.float32), strength[None])
        try:
            rolled = self._dynamics.roll_out(None, None, ROLL_S, pull)
        except SimulationDivergedError:
            return None
        ended: Float32[np.ndarray, "vertices 3"] = rolled.positions[0]
        return ended.astype(np.float64) if np.isfinite(ended).all() else None


def consistent_displacement(
    mesh: ClothMesh, seen: SeenPoints, config: RefinementConfig
) -> Float[np.ndarray, "vertices 3"]:
    """Return the displacement [m] of the mesh to where its points were seen (consistency).

    It minimizes, with x the vertices, S the interpolation to the canonical coordinates of observed
    points o, w their weights, and U the uniform Laplacian,

        c sum_p w_p |S_p (x + d) - o_p|^2 / sum_p w_p + b mean_ij |d_i - d_j|^2

    Args:
        mesh: mesh in the world [m], with canonical coordinates.
    """
    if mesh.canonical is None:
        raise InvalidMeshError(
            "the mesh has no canonical coordinates, so that consistency means nothing; give them, "
            "or refinement.consistency_weight=0"
        )
    canonical = np.asarray(mesh.canonical, np.float64)
    face, blend = closest_on_mesh(seen.canonical, canonical, mesh.faces)
    rows = np.repeat(np.arange(len(face)), 3)
    entries = (blend.ravel(), (rows, mesh.faces[face].ravel()))
    shows = sparse.coo_array(entries, (len(face), mesh.vertex_count)).tocsr()
    away = np.linalg.norm(shows @ canonical - seen.canonical, axis=1)
    miss = seen.points - shows @ mesh.vertices
    weight = seen.confidence * np.exp(-((away / _OFF_MESH_M) ** 2))
    weight = weight / (1.0 + (np.linalg.norm(miss, axis=1) / config.outlier_m) ** 2) ** 2
    if not weight.sum() > 0.0:
        return np.zeros((mesh.vertex_count, 3))
    data = shows.T @ sparse.diags_array(config.consistency_weight * weight / weight.sum())
    matrix = data @ shows + config.rigidity_weight / len(mesh.edges) * _edge_laplacian(mesh)
    # A mesh component without observed points has no equation, so keep it in place.
    matrix = matrix + _STAYS / mesh.vertex_count * sparse.eye_array(mesh.vertex_count)
    return splu(matrix.tocsc()).solve(data @ miss)


_STAYS = 1e-6


def _edge_laplacian(mesh: ClothMesh) -> sparse.csr_array:
    """Return the matrix of the sum of squared differences along edges."""
    i, j = mesh.edges.T
    count = mesh.vertex_count
    ends = (np.concatenate([i, j]), np.concatenate([j, i]))
    joined = sparse.coo_array((np.ones(2 * len(i)), ends), (count, count)).tocsr()
    return (sparse.diags_array(joined.sum(axis=1)) - joined).tocsr()
