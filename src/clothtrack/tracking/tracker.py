"""Run Algorithm 1 over one recording with a named method or with a given one."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from clothtrack.files.progress import Progress
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Recording
from clothtrack.tracking.algorithm import track
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.methods import METHODS, Assembled, Components
from clothtrack.tracking.protocols import Method, Observe, Watch
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


class Tracker:
    """Tracker of one cloth in one recording; it builds the solver and its buffers once.

    Attributes:
        method: the functions of Algorithm 1; use `dataclasses.replace` to replace one.
    """

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        config: RunConfig,
        observe: Observe,
        *,
        start: Float[np.ndarray, "vertices 3"] | None = None,
        assemble: Callable[[Components], Assembled] | None = None,
        device: str = "cpu",
    ) -> None:
        """Set up the dynamics, the aligners and the cameras.

        Args:
            mesh: the flat cloth in the world [m]; its edges give the rest lengths for the whole
                run.
            start: vertex positions at the first frame [m], if the cloth does not lie flat there.
        """
        components = Components(recording, mesh, config, observe, start, device)
        made = (assemble or METHODS[config.mode])(components)
        self.method: Method = made.method
        self._components, self._made = components, made

    def track(
        self, progress: Progress | None = None, watch: Watch | None = None
    ) -> TrackedTrajectory:
        """Run Algorithm 1 over every action of the recording."""
        components, state = self._components, self._made.state
        recorder = Recorder(
            components.recording, components.mesh, state, components.visible, progress=progress,
            watch=watch, candidates=components.search.expected_candidates(self._made.theta),
        )  # fmt: skip
        method = recorder.timed(self.method)
        track(components.recording, state, self._made.theta, method, recorder)
        return recorder.trajectory()
