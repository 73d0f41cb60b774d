"""Find the vertices that a picker holds during an action, and their path (the action a_t)."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import PickAndPlace, PickerPath, Recording
from clothtrack.simulation.picker_action import HeldMotion, PickerAction
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.theta import Theta

logger = logging.getLogger(__name__)

REACH_M = 0.03
"""Vertices farther than this [m] from the closing tip are not grasped. The reference code's
sum of picker radius, threshold and particle radius is 0.02125."""

_COLUMN_M = 0.01
"""Horizontal reach of a tip, within which layers are distinguished [m]."""

_LONGEST_PAUSE_S = 2.0
"""Cloth that nothing holds is at rest after this time [s]; a longer pause is not simulated."""

_KNOTS_PER_FRAME = 5
"""Waypoints at which the recorded path is sampled inside one frame; linear between them."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """One picker's grasp during one action.

    Attributes:
        offsets: offset from the tip to each held vertex [m], world frame.
    """

    picker: str
    path: PickerPath
    vertices: Int[np.ndarray, " held"]
    offsets: Float[np.ndarray, "held 3"]

    @property
    def moves(self) -> bool:
        """Whether the tip moves while it is closed."""
        return bool(np.ptp(self.path.positions[self.path.closed], axis=0).max() > 1e-3)

    def waypoints(
        self, start_s: float, end_s: float, offset: Float[np.ndarray, "*environments 3"]
    ) -> Float[np.ndarray, "*environments knots held 3"]:
        """Return the targets of the held vertices between two times [m], with a grasp offset."""
        times = np.linspace(start_s, end_s, _KNOTS_PER_FRAME)
        tips = np.stack([self.path.position_at(time) for time in times])
        points = tips[:, None] + self.offsets
        return points + np.asarray(offset)[..., None, None, :]


def find_grasps(
    recording: Recording,
    action: PickAndPlace,
    cloth: ClothMesh,
    layers: int = 0,
) -> tuple[Grasp, ...]:
    """Decide what each picker of an action holds, given the cloth at its start.

    Vertices named in the recording take precedence; otherwise it is the vertex nearest to the tip
    when it first closes.

    Args:
        cloth: the mesh at the action's first frame [m], world frame.
    """
    start_s = recording.frames[action.first_frame].time_s
    end_s = recording.frames[action.last_frame].time_s
    grasps = []
    for name in action.pickers:
        path = recording.picker_paths[name]
        closing_s = _first_closed(path, start_s, end_s)
        if closing_s is None:
            logger.warning("picker %s never closes between %.2f and %.2f s", name, start_s, end_s)
            continue
        tip = path.position_at(closing_s)
        vertices = _known(recording.cloth.held_vertices, name)
        if vertices is None:
            vertices = layers_under(cloth, tip, REACH_M)[:layers]
        gaps_m = np.linalg.norm(cloth.vertices - tip, axis=1)
        if len(vertices) == 0:
            vertices = np.argsort(gaps_m, kind="stable")[:1]
            vertices = vertices[gaps_m[vertices] <= REACH_M]
        if len(vertices) == 0:
            logger.warning(
                "picker %s closes at %.2f s with the nearest vertex %.1f mm away (reach %.1f mm): "
                "it holds nothing",
                name, closing_s, 1e3 * gaps_m.min(), 1e3 * REACH_M,
            )  # fmt: skip
            continue
        grasps.append(Grasp(name, path, vertices, cloth.vertices[vertices] - tip))
    return tuple(grasps)


@dataclass(frozen=True, eq=False)
class HeldCloth:
    """Grasps of the pickers of one action, and their actual offset.

    Attributes:
        offset: offset from the commanded tip to the actual grasp on the cloth [m].
    """

    grasps: tuple[Grasp, ...]
    offset: Float[np.ndarray, " 3"]

    def action(self, start_s: float, end_s: float) -> PickerAction:
        """Return a_t: what the closed pickers do between two times [s]."""
        motion = held_motion(self.grasps, start_s, end_s, self.offset)
        duration_s = end_s - start_s
        if motion is None:
            duration_s = min(duration_s, _LONGEST_PAUSE_S)
        return PickerAction(motion, duration_s, picker_speed(self.grasps, start_s, end_s))

    def closed_at(self, time_s: float) -> bool:
        """Return whether any picker holds cloth at this time [s]."""
        return any(grasp.path.closed_at(time_s) for grasp in self.grasps)

    def identity(self, theta: Theta) -> tuple[object, ...]:
        """Return a key that is equal for parameters with the same grasp of the same cloth.

        With one layer under the tip, for example, holding more layers changes nothing.
        """
        return tuple(self.held_vertices.values()), replace(theta, held_layers=0)

    @property
    def held_vertices(self) -> dict[str, tuple[int, ...]]:
        """The vertices that each picker holds, by its name."""
        return {grasp.picker: tuple(grasp.vertices.tolist()) for grasp in self.grasps}


def pick(
    action: PickAndPlace,
    state: ClothState,
    theta: Theta,
    *,
    recording: Recording,
    mesh: ClothMesh,
) -> HeldCloth:
    """Return what the pickers of an action grasp, given the cloth at its start."""
    cloth = mesh.with_vertices(state.positions[0].astype(np.float64))
    grasps = find_grasps(recording, action, cloth, theta.held_layers)
    return HeldCloth(grasps, np.array([0.0, 0.0, theta.grasp_offset_z_m]))


@dataclass(frozen=True, eq=False)
class StillCloth(HeldCloth):
    """Grasps without their motion: the ablation without action conditioning."""

    def action(self, start_s: float, end_s: float) -> PickerAction:
        """Return an action without motion, with the same duration and picker speed."""
        return replace(super().action(start_s, end_s), motion=None)


def layers_under(
    cloth: ClothMesh, tip: Float[np.ndarray, " 3"], radius_m: float
) -> Int[np.ndarray, " layers"]:
    """Return the vertex nearest to a tip in each layer of cloth under it, from top to bottom.

    A layer is a connected component of the mesh inside the column under the tip.

    Args:
        cloth: the mesh [m], world frame, z up.
        tip: the tip of the picker [m].
        radius_m: vertices farther than this [m] from the tip are not grasped.
    """
    aside = np.linalg.norm(cloth.vertices[:, :2] - tip[:2], axis=1)
    spacing_m = float(np.median(cloth.edge_lengths))
    # A column narrower than the mesh would miss layers.
    column = np.flatnonzero(aside < max(_COLUMN_M, 1.2 * spacing_m))
    if not len(column):
        return column.astype(np.int32)
    inside = np.isin(cloth.edges, column).all(axis=1)
    joined = np.searchsorted(column, cloth.edges[inside])
    graph = coo_matrix((np.ones(len(joined)), joined.T), shape=(len(column), len(column)))
    count, layer = connected_components(graph, directed=False)
    distance = np.linalg.norm(cloth.vertices[column] - tip, axis=1)
    distance[distance > radius_m] = np.inf
    nearest = [int(np.argmin(np.where(layer == each, distance, np.inf))) for each in range(count)]
    held = column[[each for each in nearest if np.isfinite(distance[each])]]
    return held[np.argsort(-cloth.vertices[held, 2], kind="stable")].astype(np.int32)


def held_motion(
    grasps: tuple[Grasp, ...],
    start_s: float,
    end_s: float,
    offset: Float[np.ndarray, "*environments 3"],
) -> HeldMotion | None:
    """Return the motion of closed pickers between two frames; None if no picker is closed."""
    closed = [grasp for grasp in grasps if grasp.path.closed_at(0.5 * (start_s + end_s))]
    if not closed:
        return None
    return HeldMotion(
        vertices=np.concatenate([grasp.vertices for grasp in closed]).astype(np.int32),
        waypoints=np.concatenate(
            [grasp.waypoints(start_s, end_s, offset) for grasp in closed], axis=-2
        ),
    )


def picker_speed(grasps: tuple[Grasp, ...], start_s: float, end_s: float) -> float:
    """Return the speed of the fastest closed picker between two frames [m/s]."""
    speeds = [
        np.linalg.norm(grasp.path.position_at(end_s) - grasp.path.position_at(start_s))
        for grasp in grasps
        if grasp.path.closed_at(0.5 * (start_s + end_s))
    ]
    return float(max(speeds, default=0.0)) / (end_s - start_s)


def _known(
    held: Mapping[str, Int[np.ndarray, " held"]], picker: str
) -> Int[np.ndarray, " held"] | None:
    return np.asarray(held[picker], np.int32) if picker in held else None


def _first_closed(path: PickerPath, start_s: float, end_s: float) -> float | None:
    if path.closed_at(start_s):
        return start_s
    closing = path.time_s[path.closed & (path.time_s >= start_s) & (path.time_s <= end_s)]
    return float(closing[0]) if len(closing) else None
