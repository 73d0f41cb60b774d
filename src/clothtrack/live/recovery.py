"""Begin anew where the mesh has lost the cloth: the network's mesh of one picture, made beside.

The network works in a process of its own. Its mesh may be of another triangulation: each vertex of
the tracked cloth goes to where its material point is there.
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
from clothtrack.recordings.geometry_checks.mesh_gap import mesh_gap_m
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import InitialStateConfig
from clothtrack.tracking.initial_state import InitialState, find_initial_state

LOST_SHARE = 0.2
"""The mesh has lost the cloth when such a share of its vertices is lost in two judgments."""

AGAIN_S = 10.0
"""After an answer that was of no use the network is asked again so much later, at the earliest [s].
"""

_NEARER = 0.7
"""The network's mesh has to be nearer to what is seen than the tracked one, by this factor."""


@dataclass(frozen=True, eq=False)
class Found:
    """A mesh to begin anew with.

    Attributes:
        positions: where the vertices of the tracked cloth are [m].
        origin: where it is from, stored with the result.
    """

    positions: Float[np.ndarray, "vertices 3"]
    origin: Mapping[str, object]


class Recovery:
    """Notices that the mesh has lost the cloth, and asks the network where it is."""

    def __init__(
        self, config: InitialStateConfig, segmenter: Segmenter | None, device: str
    ) -> None:
        """Have lost nothing.

        Args:
            config: which weights the network has.
            segmenter: finds the cloth; the recording's own way by default.
            device: "cpu" or "cuda:0".
        """
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
        """Take the latest judgment; return what to say where the cloth is lost with it."""
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
        """Ask the network for the cloth in a picture, unless it was asked a moment ago."""
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
        """Return the network's mesh once, or why there is none; None while there is no answer."""
        if self._asked is None or not self._asked.done():
            return None
        asked, self._asked = self._asked, None
        try:
            return asked.result()
        except (ClothTrackError, RuntimeError, OSError) as error:
            # The tracker goes on without: a process may die, or a network be not installed.
            return f"the mesh does not begin anew: {error}"

    def better(
        self,
        answer: InitialState,
        mesh: ClothMesh,
        positions: Float[np.ndarray, "vertices 3"],
        seen: Observation,
    ) -> Found | str:
        """Return the network's mesh where it is nearer to what is seen now, or why it is not taken.

        Args:
            answer: of the network, about an earlier picture.
            mesh: the tracked cloth, flat.
            positions: where it is taken to be [m].
            seen: the cloud of the newest picture.
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
        """End the network's process; an answer that is still made is not waited for."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            for process in self._processes:
                process.kill()


def _one_picture(recording: Recording, frame: Frame, segmenter: Segmenter | None) -> Recording:
    """Return a recording of one picture, which another process can be sent."""
    shown = replace(frame, index=0, time_s=0.0)
    (camera,) = recording.cameras
    if segmenter is not None:
        color = frame.color.get(camera.name)
        mask = segmenter(color, frame.depth[camera.name], camera, recording.table)
        shown = replace(shown, mask={camera.name: mask})
    cloth = replace(recording.cloth, template=None, held_vertices={})
    return replace(recording, frames=(shown,), actions=(), picker_paths={}, cloth=cloth)


def _answer(recording: Recording, config: InitialStateConfig, device: str) -> InitialState:
    """Return the network's mesh of the only picture; in a process of its own."""
    from clothtrack.recordings.point_cloud import observe

    (frame,) = recording.frames
    return find_initial_state(recording, observe(recording, frame), config, device=device)
