"""TTO2: at the end of an action, align the mesh to the cloud once more and leave it at rest."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.silhouette import slide_to_outline
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.state import Attachment, ClothState
from clothtrack.simulation.untangling import Untangler
from clothtrack.tracking.protocols import Correction, State
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.visible_alignment import VisibleAlignment

logger = logging.getLogger(__name__)

FINAL_STRENGTH = 1.0 - 1e-5
"""Strength of the pseudo-action that applies a final alignment: just below 1, so that contacts,
stretch and table still take precedence over the observation."""

SEEN_MOBILITY = 0.1
"""Mobility of a visible vertex during untangling: low, because its position was measured."""


@dataclass(frozen=True, eq=False)
class FinalAlignment:
    """Final alignment: slide a free cloth to its outline, then align its visible vertices.

    Self-intersections are untangled before and after.

    Attributes:
        recording: the recording; its name is used in messages, and its table for sliding.
        slide: slide and turn a free cloth on its table as a rigid body until its outline fits,
            because nearest points alone would keep a slipped cloth where it is.
        rounds: how often the alignment is computed and applied; each round starts from the result
            of the dynamics in the round before.
        roll_s: time over which the dynamics apply a correction [s]. It is short, so that gravity
            has little effect but layers keep their sides. 0 displaces the vertices at once,
            through any obstacle (the paper).
    """

    recording: Recording
    mesh: ClothMesh
    align: VisibleAlignment
    dynamics: ClothDynamics
    slide: bool = True
    untangle: bool = True
    rounds: int = 2
    roll_s: float = 0.1
    device: str = "cpu"

    @cached_property
    def _untangler(self) -> Untangler:
        return Untangler(self.mesh, device=self.device)

    def __call__(
        self, state: ClothState, theta: Theta, observation: Observation, held: bool
    ) -> tuple[ClothState, tuple[float, float]]:
        """Return the state that the next action starts from: aligned, at rest, contacts kept.

        Returns:
            The state, and the objective [m^2] before and after; NaN if there was no cloud.
        """
        self.dynamics.solver.set_parameters(theta.cloth_parameters(self.dynamics.solver.mesh))
        if self.slide and not held:
            state = self._slid(state, observation)
        state = self._untangled(state)
        losses = (np.nan, np.nan)
        for _ in range(self.rounds):
            correction = self.align.aligned(state.positions[0], observation)
            if correction is None:
                break
            first = correction.losses[0] if np.isnan(losses[0]) else losses[0]
            losses = (first, correction.losses[1])
            state = self._corrected(state, correction)
        return self._untangled(state), losses

    def _slid(self, state: ClothState, observation: Observation) -> ClothState:
        """Return the cloth slid over the table as a whole until its outline fits, at rest."""
        positions = state.positions[0]
        if self.recording.table is None or not np.isfinite(positions).all():
            return state
        moved = slide_to_outline(
            self.mesh,
            positions.astype(np.float64),
            observation,
            self.recording.table,
            device=self.device,
        )
        return self._at_rest(state, moved)

    def _corrected(self, state: ClothState, correction: Correction) -> ClothState:
        """Return the state after a correction, rolled out or displaced at once, at rest."""
        targets = state.positions + correction.displacement[None]
        if self.roll_s == 0.0:
            return self._at_rest(state, targets)
        strength = np.where(correction.attached, FINAL_STRENGTH, 0.0).astype(np.float32)
        pull = Attachment(targets.astype(np.float32), strength[None])
        return rolled_to(self.dynamics, state, pull, self.roll_s, self.recording.name)

    def _untangled(self, state: ClothState) -> ClothState:
        """Return the state with as few crossings as possible, at rest.

        Contact pairs of moved vertices are dropped, because a crossing had swapped their sides.
        """
        positions = state.positions[0]
        if not self.untangle or not np.isfinite(positions).all():
            return state
        mobility = np.where(self.align.visible(positions), SEEN_MOBILITY, 1.0)
        apart = self._untangler(positions, mobility=mobility, table=self.recording.table)
        moved = (apart.positions != positions).any(axis=1)
        if not moved.any():
            return state
        memory = state.contacts.without(moved, self.mesh.faces)
        return self._at_rest(replace(state, contacts=memory), apart.positions)

    def _at_rest(
        self, state: ClothState, vertices: Float[np.ndarray, "*environments vertices 3"]
    ) -> ClothState:
        """Return the state with its vertices placed here [m], through any obstacle, at rest."""
        solver = self.dynamics.solver
        solver.restore(state)
        solver.place(vertices)
        solver.set_velocities(np.zeros_like(state.velocities))
        return solver.save()


def rolled_to(
    dynamics: ClothDynamics, state: ClothState, pull: Attachment, roll_s: float, name: str
) -> ClothState:
    """Pull the cloth to a target with the dynamics, so that layers keep their sides.

    Args:
        roll_s: duration of the roll-out [s].
    """
    solver = dynamics.solver
    rolled = dynamics.roll_out(state, None, roll_s, pull)
    if not np.isfinite(rolled.positions).all():
        logger.warning("%s: the end of an action diverges, its correction is dropped", name)
        solver.restore(state)
    solver.set_velocities(np.zeros_like(state.velocities))
    return solver.save()


def no_final_alignment(
    state: State,
    theta: Theta,  # noqa: ARG001
    observation: Observation,  # noqa: ARG001
    held: bool,  # noqa: ARG001
) -> tuple[State, tuple[float, float]]:
    """Return the state unchanged: the ablation without TTO2."""
    return state, (np.nan, np.nan)
