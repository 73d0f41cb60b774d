"""How far to trust the mesh, a few times a second, beside the stream.

The evidence is that of a label (`evaluation.label_evidence`), taken in a smaller picture and with
fewer points: a judgment takes some 30 ms instead of 150.
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
"""Pictures are judged that are at least so far apart [s]."""

_WIDTH = 160
"""Width of the pictures in which outlines are compared [pixels]."""

_SPACING_M = 0.012
"""Clouds are thinned to this before distances are taken [m]."""


@dataclass(frozen=True, eq=False)
class Judgment:
    """What speaks against a mesh, vertex by vertex.

    Attributes:
        time_s: of its picture [s]; NaN: nothing was judged yet.
        expected_error_m: error to expect of each vertex [m].
        lost: vertices farther from what was seen than `FAR_M`.
    """

    time_s: float
    expected_error_m: Float[np.ndarray, " vertices"]
    lost: Bool[np.ndarray, " vertices"]

    @classmethod
    def none(cls, vertices: int) -> "Judgment":
        """Return what is known of a mesh before it was judged."""
        return cls(np.nan, np.full(vertices, np.nan), np.zeros(vertices, bool))


class LiveJudge:
    """Judges the newest mesh in a thread of its own, one at a time."""

    def __init__(self, mesh: ClothMesh, device: str) -> None:
        """Judge nothing yet.

        Args:
            mesh: the flat cloth.
            device: "cpu" or "cuda:0", for outlines.
        """
        self._mesh, self._device = mesh, device
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="clothtrack-judge")
        self._busy: Future[Judgment] | None = None
        self._latest = Judgment.none(mesh.vertex_count)
        self._label = np.asarray(mesh.vertices, np.float64)
        self._shift_m = self._travelled_m = 0.0
        self._actions, self._asked_s = 0, -np.inf
        self._before = self._label, self._travelled_m

    @property
    def latest(self) -> Judgment:
        """The last judgment.

        Raises:
            Exception: whatever went wrong with it.
        """
        if self._busy is not None and self._busy.done():
            self._latest, self._busy = self._busy.result(), None
        return self._latest

    def look(
        self, time_s: float, positions: Float[np.ndarray, "vertices 3"], seen: Observation
    ) -> None:
        """Judge a mesh, unless another one is being judged or was a moment ago.

        Args:
            time_s: of its picture [s].
            positions: vertices [m].
            seen: the cloud of its picture.
        """
        if self._busy is not None or time_s - self._asked_s < EVERY_S:
            return
        self._asked_s = time_s
        vertices = positions.astype(np.float64)
        before = vertices + (self._shift_m, 0.0, 0.0)  # as far as the last final alignment moved it
        way_m = self._travelled_m + mean_distance(vertices, self._label)
        label = Label(0, vertices, before)
        self._busy = self._thread.submit(self._judged, time_s, label, seen, way_m)

    def end_action(
        self, before: Float[np.ndarray, "vertices 3"], after: Float[np.ndarray, "vertices 3"]
    ) -> None:
        """Take the mesh at the end of an action [m], before and after its final alignment."""
        after = after.astype(np.float64)
        self._before = self._label, self._travelled_m
        self._travelled_m += mean_distance(after, self._label)
        self._shift_m = mean_distance(after, before.astype(np.float64))
        self._label, self._asked_s = after, -np.inf
        self._actions += 1

    def end_otherwise(
        self, before: Float[np.ndarray, "vertices 3"], after: Float[np.ndarray, "vertices 3"]
    ) -> None:
        """Take another mesh for the end of the last action [m], as `end_action` takes it."""
        self._label, self._travelled_m = self._before
        self._actions -= 1
        self.end_action(before, after)

    def wait(self) -> None:
        """Wait for a judgment that is under way."""
        if self._busy is not None:
            self._busy.exception()

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
    """Return an observation in smaller pictures."""
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
