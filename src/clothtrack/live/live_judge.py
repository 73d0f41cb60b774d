"""Judgment of the live mesh a few times per second, in parallel with the stream.

The evidence is that of a label (`evaluation.label_evidence`), but with a smaller picture and fewer
points, so that a judgment takes about 30 ms instead of 150.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.evaluation.label_evidence import Label, mean_distance, mesh_evidence
from clothtrack.evaluation.label_quality import FAR_M, shipped_model
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation, thin

EVERY_S = 0.5
"""Least time between judged pictures [s]."""

_WIDTH = 160
"""Width of the pictures for comparing outlines [pixels]."""

_SPACING_M = 0.012
"""Point spacing of the clouds used for distances [m]."""


@dataclass(frozen=True, eq=False)
class Judgment:
    """Evidence against a mesh, per vertex.

    Attributes:
        time_s: time of its picture [s]; NaN if nothing was judged yet.
        expected_error_m: expected error of each vertex [m].
        lost: vertices farther than `FAR_M` from the observation.
    """

    time_s: float
    expected_error_m: Float[np.ndarray, " vertices"]
    lost: Bool[np.ndarray, " vertices"]

    @classmethod
    def none(cls, vertices: int) -> "Judgment":
        """Return the judgment of a mesh that was not judged yet."""
        return cls(np.nan, np.full(vertices, np.nan), np.zeros(vertices, bool))


class LiveJudge:
    """Judge of the newest mesh in a separate thread, one mesh at a time."""

    def __init__(self, mesh: ClothMesh, device: str) -> None:
        """Start the thread."""
        self._mesh, self._device = mesh, device
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="clothtrack-judge")
        self._busy: Future[Judgment] | None = None
        self._latest = Judgment.none(mesh.vertex_count)
        self._label = np.asarray(mesh.vertices, np.float64)
        self._shift_m = self._travelled_m = 0.0
        self._actions, self._asked_s = 0, -np.inf

    @property
    def latest(self) -> Judgment:
        """The last judgment."""
        if self._busy is not None and self._busy.done():
            self._latest, self._busy = self._busy.result(), None
        return self._latest

    def look(
        self, time_s: float, positions: Float[np.ndarray, "vertices 3"], seen: Observation
    ) -> None:
        """Start judging a mesh [m] of a picture, unless a judgment is running or recent."""
        if self._busy is not None or time_s - self._asked_s < EVERY_S:
            return
        self._asked_s = time_s
        vertices = positions.astype(np.float64)
        before = vertices + (self._shift_m, 0.0, 0.0)  # shift of the last final alignment
        way_m = self._travelled_m + mean_distance(vertices, self._label)
        label = Label(0, vertices, before)
        self._busy = self._thread.submit(self._judged, time_s, label, seen, way_m)

    def end_action(
        self, before: Float[np.ndarray, "vertices 3"], after: Float[np.ndarray, "vertices 3"]
    ) -> None:
        """Record the mesh at the end of an action [m], before and after its final alignment."""
        after = after.astype(np.float64)
        self._travelled_m += mean_distance(after, self._label)
        self._shift_m = mean_distance(after, before.astype(np.float64))
        self._label, self._asked_s = after, -np.inf
        self._actions += 1

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown()

    def _judged(self, time_s: float, label: Label, seen: Observation, way_m: float) -> Judgment:
        evidence = mesh_evidence(
            self._mesh, label, _reduced(seen), thin(seen.points, _SPACING_M),
            travelled_m=way_m, action=max(self._actions, 1), device=self._device,
        )  # fmt: skip
        assert evidence.misfit is not None
        error_m = shipped_model().expected_error_m(evidence)
        patch_m = evidence.misfit.patch_m
        return Judgment(time_s, np.maximum(error_m, patch_m), patch_m > FAR_M)


def _reduced(seen: Observation) -> Observation:
    """Return an observation with smaller pictures."""
    cameras = tuple(camera.resized(min(_WIDTH, camera.width)) for camera in seen.cameras)
    hidden = {
        camera.name: cv2.resize(
            seen.hidden[camera.name].view(np.uint8), (camera.width, camera.height),
            interpolation=cv2.INTER_NEAREST,
        ).view(bool)
        for camera in cameras
        if camera.name in seen.hidden
    }  # fmt: skip
    return replace(seen, cameras=cameras, hidden=hidden)
