"""Which vertices a picker holds during an action, and where it takes them (the action a_t)."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from clothtrack.recordings.recording import PickAndPlace, PickerPath, Recording
from clothtrack.simulation.dynamics import HeldMotion
from clothtrack.simulation.picker import grasp_vertices

logger = logging.getLogger(__name__)

KNOTS_PER_FRAME = 5
"""Way points at which the recorded path is read inside one frame; linear between them."""


@dataclass(frozen=True)
class PickingConfig:
    """How a picker takes hold of the mesh.

    Attributes:
        radius_m: vertices farther from the closing tip than this [m] are not taken hold of.
            The reference code's sum of picker radius, threshold and particle radius is 0.02125.
        count: how many of the nearest vertices are held; 1 in the paper.
    """

    radius_m: float = 0.03
    count: int = 1


@dataclass(frozen=True, eq=False)
class Grasp:
    """One picker's hold during one action.

    Attributes:
        picker: the picker's name.
        path: where its tip was.
        vertices: the vertices it holds while closed.
        offsets: from the tip to each held vertex [m], world frame.
    """

    picker: str
    path: PickerPath
    vertices: Int[np.ndarray, " held"]
    offsets: Float[np.ndarray, "held 3"]

    @property
    def moves(self) -> bool:
        """Whether the tip goes anywhere at all while it is closed."""
        return bool(np.ptp(self.path.positions[self.path.closed], axis=0).max() > 1e-3)

    def way_points(
        self, start_s: float, end_s: float, offset: Float[np.ndarray, "*environments 3"]
    ) -> Float[np.ndarray, "*environments knots held 3"]:
        """Where the held vertices are to be between two times [m], shifted by a grasp offset."""
        times = np.linspace(start_s, end_s, KNOTS_PER_FRAME)
        tips = np.stack([self.path.position_at(time) for time in times])
        points = tips[:, None] + self.offsets
        return points + np.asarray(offset)[..., None, None, :]


def find_grasps(
    recording: Recording,
    action: PickAndPlace,
    positions: Float[np.ndarray, "vertices 3"],
    config: PickingConfig,
) -> tuple[Grasp, ...]:
    """Decide what each picker of an action holds, from where the cloth lies when it starts.

    Vertices named in the recording win; otherwise the nearest to the tip when it first closes.

    Args:
        recording: holds the picker paths and, if known, the held vertices.
        action: the pick-and-place.
        positions: the mesh at the action's first frame [m], world frame.
        config: reach and number of vertices.
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
        known = _known(recording.cloth.held_vertices, name)
        vertices = (
            known
            if known is not None
            else grasp_vertices(positions, tip, config.radius_m, config.count)
        )
        if len(vertices) == 0:
            nearest = float(np.linalg.norm(positions - tip, axis=1).min())
            logger.warning(
                "picker %s closes at %.2f s with the nearest vertex %.1f mm away (reach %.1f mm): "
                "it holds nothing",
                name, closing_s, 1e3 * nearest, 1e3 * config.radius_m,
            )  # fmt: skip
            continue
        grasps.append(Grasp(name, path, vertices, positions[vertices] - tip))
    return tuple(grasps)


def held_motion(
    grasps: tuple[Grasp, ...],
    start_s: float,
    end_s: float,
    offset: Float[np.ndarray, "*environments 3"],
) -> HeldMotion | None:
    """What the closed pickers do between two frames; None when none of them is closed."""
    closed = [grasp for grasp in grasps if grasp.path.closed_at(0.5 * (start_s + end_s))]
    if not closed:
        return None
    return HeldMotion(
        vertices=np.concatenate([grasp.vertices for grasp in closed]).astype(np.int32),
        way_points=np.concatenate(
            [grasp.way_points(start_s, end_s, offset) for grasp in closed], axis=-2
        ),
    )


def picker_speed(grasps: tuple[Grasp, ...], start_s: float, end_s: float) -> float:
    """Speed of the fastest closed picker between two frames [m/s]."""
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
