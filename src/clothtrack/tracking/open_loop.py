"""Score parameters by rolling out an action without corrections (paper, Sec. III-B.1)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.cloud_distance import masked_chamfer
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import PickAndPlace, Recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.picking import HeldCloth, held_motion
from clothtrack.tracking.protocols import Observe
from clothtrack.tracking.theta import Theta

BATCH = 36
"""Maximum environments in one batch; it bounds the memory of a search with many candidates."""


@dataclass(frozen=True, eq=False)
class OpenLoopScore:
    """Score of candidates that are rolled out in batches and compared with the last cloud.

    Environments are independent, so the batch size does not change the scores. A GPU simulates a
    large batch in the time of a small one and keeps one solver; on a CPU the time grows with every
    environment.

    Attributes:
        widest: maximum number of candidates that are scored at once.
    """

    recording: Recording
    mesh: ClothMesh
    solver: SolverConfig
    observe: Observe
    visible: VisibilityCheck
    widest: int = BATCH
    device: str = "cpu"
    _dynamics: dict[int, ClothDynamics] = field(default_factory=dict, init=False)

    def __call__(
        self, state: ClothState, action: PickAndPlace, held: HeldCloth, thetas: Sequence[Theta]
    ) -> list[float]:
        """Return the Chamfer distance [m^2] of each candidate from the last cloud."""
        parts = [thetas[at : at + self.widest] for at in range(0, len(thetas), self.widest)]
        return [score for part in parts for score in self._scores(state, action, held, part)]

    def _scores(
        self, state: ClothState, action: PickAndPlace, held: HeldCloth, thetas: Sequence[Theta]
    ) -> list[float]:
        dynamics = self._dynamics_of(len(thetas))
        # Environments without a candidate repeat the last one.
        rows = [thetas[min(at, len(thetas) - 1)] for at in range(dynamics.solver.environments)]
        dynamics.solver.set_parameters([each.cloth_parameters(self.mesh) for each in rows])
        offsets = np.array([[0.0, 0.0, each.grasp_offset_z_m] for each in rows])
        frames = self.recording.frames[action.first_frame : action.last_frame + 1]
        rolled = None
        for before, frame in pairwise(frames):
            motion = held_motion(held.grasps, before.time_s, frame.time_s, offsets)
            start = state if rolled is None else None
            rolled = dynamics.roll_out(start, motion, frame.time_s - before.time_s)
        assert rolled is not None
        observation = self.observe(frames[-1])
        return [self._chamfer(each, observation) for each in rolled.positions[: len(thetas)]]

    def _dynamics_of(self, candidates: int) -> ClothDynamics:
        """Return dynamics with room for this many candidates."""
        width = candidates if self.device == "cpu" else self.widest
        if width not in self._dynamics:
            solver = ClothSolver(self.mesh, self.solver, environments=width, device=self.device)
            self._dynamics[width] = ClothDynamics(solver)
        return self._dynamics[width]

    def _chamfer(
        self, positions: Float[np.ndarray, "vertices 3"], observation: Observation
    ) -> float:
        if not np.isfinite(positions).all():
            return np.inf
        return masked_chamfer(positions, self.visible(positions), observation)
