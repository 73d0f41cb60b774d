"""Recovery of a lost cloth from the network's mesh of one picture.

The network runs in a separate process. Its mesh may have another triangulation, so each vertex of
the tracked cloth moves to its material point on that mesh.
"""

from collections.abc import Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.files.worker_pool import start_worker
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.live.live_judge import Judgment
from clothtrack.reconstruction.first_mesh import carried_over
from clothtrack.recordings.geometry_checks.cloth import mesh_gap_m
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import InitialStateConfig
from clothtrack.tracking.initial_state import InitialState, find_initial_state

LOST_SHARE = 0.2
"""Share of lost vertices, in two judgments, from which the mesh has lost the cloth."""

AGAIN_S = 10.0
"""Least time between two requests to the network [s]."""

_NEARER = 0.7
"""The network's mesh is used if its gap to the cloud is below this share of the tracked one's."""


@dataclass(frozen=True, eq=False)
class Found:
    """Mesh to restart with.

    Attributes:
        positions: vertices of the tracked cloth [m].
        origin: source of the mesh, stored with the result.
    """

    positions: Float[np.ndarray, "vertices 3"]
    origin: Mapping[str, object]


class Recovery:
    """Detector of a lost cloth, which requests a new mesh from the network."""

    def __init__(
        self, config: InitialStateConfig, segmenter: Segmenter | None, device: str
    ) -> None:
        """Set the network and the segmentation."""
        self._config = replace(config, source="network", template="")
        self._segmenter, self._device = segmenter, device
        self._pool: ProcessPoolExecutor | None = None
        self._processes = set[BaseProcess]()
        self._asked: Future[InitialState] | None = None
        self._asked_s = self._judged_s = -np.inf
        self._in_a_row = 0

    @property
    def astray(self) -> bool:
        """Whether the mesh has lost the cloth."""
        return self._in_a_row >= 2

    def look(self, judged: Judgment) -> str:
        """Record the latest judgment; return a message if the cloth is newly lost."""
        if not judged.time_s > self._judged_s:
            return ""
        before, self._judged_s = self.astray, judged.time_s
        share = float(judged.lost.mean())
        self._in_a_row = self._in_a_row + 1 if share >= LOST_SHARE else 0
        if before or not self.astray:
            return ""
        return (
            f"the mesh has lost the cloth: {100 * share:.0f} % of it is more than 15 mm away from "
            "what was seen"
        )

    def ask(self, recording: Recording, frame: Frame) -> None:
        """Request the network's mesh of a picture, unless a request is recent."""
        if self._asked is not None or frame.time_s - self._asked_s < AGAIN_S:
            return
        self._asked_s = frame.time_s
        asked = _one_picture(recording, frame, self._segmenter)
        others = set(active_children())
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, get_context("spawn"), start_worker)
        self._asked = self._pool.submit(_answer, asked, self._config, self._device)
        self._processes |= set(active_children()) - others

    def answer(self) -> InitialState | str | None:
        """Return the network's mesh once, or why there is none; None if it is not ready."""
        if self._asked is None or not self._asked.done():
            return None
        asked, self._asked = self._asked, None
        try:
            return asked.result()
        except (ClothTrackError, RuntimeError, OSError) as error:
            # The tracker continues without it: the process may die, or no network be installed.
            return f"the mesh does not begin anew: {error}"

    def better(
        self,
        answer: InitialState,
        mesh: ClothMesh,
        positions: Float[np.ndarray, "vertices 3"],
        seen: Observation,
    ) -> Found | str:
        """Return the network's mesh if it is nearer to the cloud, or why it is rejected.

        Args:
            positions: its tracked vertices [m].
        """
        canonical = answer.mesh.canonical
        if mesh.canonical is None or canonical is None or answer.positions is None:
            return (
                "the mesh does not begin anew: the cloth's template has no canonical coordinates, "
                "by which the network names what it sees"
            )
        there = carried_over(
            np.asarray(mesh.canonical, np.float64), np.asarray(canonical, np.float64),
            answer.positions, answer.mesh.faces,
        )  # fmt: skip
        gaps = [
            mesh_gap_m(each, mesh.faces, seen, device=self._device)
            for each in (there, positions.astype(np.float64))
        ]
        found, before = (np.inf if gap is None else gap for gap in gaps)
        if not found < _NEARER * before:
            return (
                f"the mesh does not begin anew: the network's lies {1e3 * found:.0f} mm (rms) from "
                f"what is seen, the tracked one {1e3 * before:.0f}"
            )
        self._in_a_row = 0
        return Found(there, answer.origin)

    def close(self) -> None:
        """End the network's process without waiting for a running request."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            for process in self._processes:
                process.kill()


def _one_picture(recording: Recording, frame: Frame, segmenter: Segmenter | None) -> Recording:
    """Return a recording of one picture that can be sent to another process."""
    shown = replace(frame, index=0, time_s=0.0)
    (camera,) = recording.cameras
    if segmenter is not None:
        color = frame.color.get(camera.name)
        mask = segmenter(color, frame.depth[camera.name], camera, recording.table)
        shown = replace(shown, mask={camera.name: mask})
    cloth = replace(recording.cloth, template=None, held_vertices={})
    return replace(recording, frames=(shown,), actions=(), picker_paths={}, cloth=cloth)


def _answer(recording: Recording, config: InitialStateConfig, device: str) -> InitialState:
    """Return the network's mesh of the only picture; runs in a separate process."""
    from clothtrack.recordings.point_cloud import observe

    (frame,) = recording.frames
    return find_initial_state(recording, observe(recording, frame), config, device=device)
