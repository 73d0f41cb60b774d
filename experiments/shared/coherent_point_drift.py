"""A model-free baseline: coherent point drift with a projection onto the edge lengths.

The method follows CDCPD (Chi and Berenson, "Occlusion-robust deformable object tracking without
physics simulation", IROS 2019), without its commercial solver. The visible vertices drift
coherently to the cloud (Myronenko and Song, DOI 10.1109/TPAMI.2010.46; biocpd does the
registration). The hidden ones follow the same smooth field, held vertices follow the tool, and then
edges that became too long are shortened. In contrast to a simulator it has no gravity, contact or
friction.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording, Table
from clothtrack.simulation.picker_action import HeldMotion, PickerAction
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.algorithm import track
from clothtrack.tracking.calibration import Uncalibrated
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.feature_anchors import no_anchors
from clothtrack.tracking.final_alignment import no_final_alignment
from clothtrack.tracking.picking import HeldCloth, StillCloth, find_grasps
from clothtrack.tracking.protocols import Corrected, Correction, Dynamics, Method
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.rest import never_at_rest
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


@dataclass(frozen=True, eq=False)
class Vertices:
    """The state of a cloth without dynamics, which is also its prediction.

    Attributes:
        positions: vertex positions in the world [m].
    """

    positions: Float[np.ndarray, "1 vertices 3"]
    highest_speed: Float[np.ndarray, " 1"] = field(default_factory=lambda: np.zeros(1))
    exact: bool = True

    @property
    def state(self) -> "Vertices":
        """The state itself."""
        return self

    @property
    def started_at(self) -> Float[np.ndarray, "1 vertices 3"]:
        """The positions before, which are the same."""
        return self.positions


_ALPHA, _BETA_M = 3.0, 0.1
"""Weight of coherence against fit (0.5 in CDCPD), and width of the kernel within which vertices
move together [m]."""

_LENGTHS = 0.95, 1.0
"""Bounds of an edge, as shares of its length in the first mesh; CDCPD has only an upper bound.
These and the two values above were chosen out of 12 combinations by the true error of one action of
a towel and one of a T-shirt; CDCPD's alpha and one-sided lengths did worse."""

_SWEEPS = 20
"""Number of passes over all edges."""

_OUTLIERS = 0.1
"""Share of the cloud that is not cloth, as in CDCPD."""

_START_SIGMA_M = 0.01
"""Initial standard deviation of a frame's registration [m]: how far the cloth may move between
frames."""

_REST_HEIGHT_M = 0.0015
"""Least height of a vertex above the table [m]."""

_VISIBILITY_WIDTH = 320
"""Width of the z-buffer that decides visibility [pixels]."""


@dataclass(frozen=True)
class PeerConfig:
    """The settings of the baseline.

    Attributes:
        iterations: largest number of expectation-maximization steps per frame.
        modes: number of modes of the kernel's low-rank form.
        neighbors: number of nearest cloud points that a vertex may correspond to.
        use_tool: whether held vertices follow the tool, like CDCPD's grasped points.
    """

    iterations: int = 30
    modes: int = 150
    neighbors: int = 10
    use_tool: bool = True


def follow(
    recording: Recording,
    mesh: ClothMesh,
    observe: Callable[[Frame], Observation],
    config: PeerConfig,
    *,
    device: str = "cpu",
) -> TrackedTrajectory:
    """Track the cloth in a recording without dynamics; the result has the tracker's format.

    Args:
        mesh: flat first mesh in the world [m].
    """
    cameras = tuple(camera.resized(_VISIBILITY_WIDTH) for camera in recording.cameras)
    visible = VisibilityCheck(mesh.faces, cameras, tolerance_m=0.003, device=device)
    start = Vertices(mesh.vertices.astype(np.float64)[None])

    def align(predicted: Vertices, observation: Observation) -> Correction:
        vertices = predicted.positions[0]
        seen = visible(vertices.astype(np.float32))
        moved = drifted(vertices, seen, observation.points, config)
        return Correction(vertices, moved - vertices, seen, (np.nan, np.nan))

    hold = _Tool if config.use_tool else StillCloth
    method = Method(
        observe=observe,
        calibrate=Uncalibrated(partial(_pick, recording=recording, mesh=mesh, hold=hold)),
        dynamics=lambda _: _Still(),
        align=align,
        line_search=_Projection(mesh, recording.table),
        align_last=no_final_alignment,
        anchor=no_anchors,
        at_rest=never_at_rest,
    )
    recorder = Recorder(recording, mesh, start, visible)
    track(recording, start, RunConfig().cloth.theta(), recorder.timed(method), recorder)
    return recorder.trajectory()


def drifted(
    vertices: Float[np.ndarray, "vertices 3"],
    seen: Bool[np.ndarray, " vertices"],
    cloud: Float[np.ndarray, "points 3"],
    config: PeerConfig,
) -> Float[np.ndarray, "vertices 3"]:
    """Return the vertices [m] after a coherent drift of the visible ones to the cloud."""
    if seen.sum() < config.modes or len(cloud) < config.neighbors:
        return vertices
    from biocpd import DeformableRegistration

    # Use the kernel's width as the unit, so that single precision is accurate enough.
    middle, unit = vertices.mean(axis=0), _BETA_M
    source, target = (vertices - middle) / unit, (cloud - middle) / unit
    registration = DeformableRegistration(
        X=target,
        Y=source[seen],
        sigma2=(_START_SIGMA_M / unit) ** 2,
        alpha=_ALPHA,
        beta=1.0,
        w=_OUTLIERS,
        k=config.neighbors,
        num_eig=config.modes,
        low_rank_method="pivoted_cholesky",
        max_iterations=config.iterations,
        tolerance=1e-5,
        dtype=np.float64,
    )
    drift = registration.register()[0] - source[seen]
    return vertices + unit * _carried(source, seen, drift)


def _carried(
    source: Float[np.ndarray, "vertices 3"],
    seen: Bool[np.ndarray, " vertices"],
    drift: Float[np.ndarray, "seen 3"],
) -> Float[np.ndarray, "vertices 3"]:
    """Return the drift of all vertices; hidden ones take the kernel mean of visible ones."""
    motion = np.zeros(source.shape)
    motion[seen] = drift
    if not seen.all():
        squared = ((source[~seen, None] - source[None, seen]) ** 2).sum(axis=2)
        # The weights are much narrower than the kernel, so that a hidden vertex follows the layer
        # over it.
        weights = np.exp(-8.0 * (squared - squared.min(axis=1, keepdims=True)))
        motion[~seen] = weights @ drift / weights.sum(axis=1, keepdims=True)
    return motion


class _Projection:
    """A projection that applies the whole correction, then enforces tool, edges and table."""

    def __init__(self, mesh: ClothMesh, table: Table | None) -> None:
        """Compute the rest lengths from the first mesh."""
        self._edges, self._table = EdgeLengths(mesh), table

    def __call__(
        self,
        dyn: Dynamics,  # noqa: ARG002
        state: Vertices,  # noqa: ARG002
        action: PickerAction,
        predicted: Vertices,  # noqa: ARG002
        correction: Correction | None,
    ) -> Corrected:
        """Return the vertices after one frame, without dynamics."""
        assert correction is not None
        vertices = correction.start + correction.displacement
        fixed = np.zeros(len(vertices), bool)
        if action.motion is not None:
            vertices[action.motion.vertices] = action.motion.at(1.0)[0]
            fixed[action.motion.vertices] = True
        vertices = self._edges.project(vertices, fixed, lengths=_LENGTHS, sweeps=_SWEEPS)
        vertices = _above_table(vertices, self._table)
        return Corrected(Vertices(vertices[None]))


class _Still:
    """Static dynamics: without a correction the cloth does not move."""

    def __call__(
        self,
        state: Vertices,
        action: PickerAction,  # noqa: ARG002
        pseudo_action: Attachment | None = None,  # noqa: ARG002
    ) -> Vertices:
        return state

    def predict(self, state: Vertices, action: PickerAction) -> Vertices:  # noqa: ARG002
        return state


class _Tool(HeldCloth):
    """The tool as the baseline uses it: its position at the end of a frame."""

    def action(self, start_s: float, end_s: float) -> PickerAction:
        """Return the held vertices at the tip of each tool that is closed at the end."""
        closed = [grasp for grasp in self.grasps if grasp.path.closed_at(end_s)]
        if not closed:
            return PickerAction(None, end_s - start_s)
        held = np.concatenate([grasp.vertices for grasp in closed]).astype(np.int32)
        targets = [grasp.path.position_at(end_s) + grasp.offsets for grasp in closed]
        return PickerAction(HeldMotion(held, np.concatenate(targets)[None]), end_s - start_s)


def _pick(
    action: PickAndPlace,
    state: Vertices,
    theta: Theta,  # noqa: ARG001
    *,
    recording: Recording,
    mesh: ClothMesh,
    hold: type[HeldCloth],
) -> HeldCloth:
    """Return the vertices that the tool holds."""
    grasps = find_grasps(recording, action, mesh.with_vertices(state.positions[0]))
    return hold(grasps, np.zeros(3))


class EdgeLengths:
    """A projection of edges onto their length bounds, color by color (Gauss-Seidel)."""

    def __init__(self, mesh: ClothMesh) -> None:
        """Compute the rest lengths from the first mesh, and color its edges."""
        self._edges = np.asarray(mesh.edges)
        self._rest = np.asarray(mesh.edge_lengths, np.float64)
        self._colors = _edge_colors(self._edges, len(mesh.vertices))

    def project(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        fixed: Bool[np.ndarray, " vertices"],
        *,
        lengths: tuple[float, float],
        sweeps: int,
    ) -> Float[np.ndarray, "vertices 3"]:
        """Return the vertices [m] after `sweeps` passes over all edges; `fixed` ones stay.

        Args:
            vertices: vertices before the projection [m].
        """
        shortest, longest = lengths
        vertices = np.array(vertices, np.float64)
        free = np.where(fixed, 0.0, 1.0)
        for _ in range(sweeps):
            for chosen in self._colors:
                a, b = self._edges[chosen].T
                gap = vertices[b] - vertices[a]
                length = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
                rest = self._rest[chosen]
                excess = length - np.clip(length, shortest * rest, longest * rest)
                share = excess / (length * np.maximum(free[a] + free[b], 1.0))
                vertices[a] += (free[a] * share)[:, None] * gap
                vertices[b] -= (free[b] * share)[:, None] * gap
        return vertices


def _edge_colors(edges: Int[np.ndarray, "edges 2"], count: int) -> list[Int[np.ndarray, " of"]]:
    """Return sets of edges that share no vertex, by first fit."""
    used: list[set[int]] = [set() for _ in range(count)]
    colors: list[list[int]] = []
    for number, (a, b) in enumerate(edges.tolist()):
        taken = used[a] | used[b]
        color = next(c for c in range(len(taken) + 1) if c not in taken)
        if color == len(colors):
            colors.append([])
        colors[color].append(number)
        used[a].add(color)
        used[b].add(color)
    return [np.array(each) for each in colors]


def _above_table(
    vertices: Float[np.ndarray, "vertices 3"], table: Table | None
) -> Float[np.ndarray, "vertices 3"]:
    if table is None:
        return vertices
    sunk = np.maximum(_REST_HEIGHT_M - table.heights(vertices), 0.0)
    return vertices + sunk[:, None] * table.normal
