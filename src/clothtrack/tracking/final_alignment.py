"""TTO2: at the end of an action the mesh is aligned to the cloud once more, and left at rest."""

import logging
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.silhouette import slide_to_outline
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.state import Attachment, ClothState
from clothtrack.simulation.untangling import Untangler
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.seams import Correction, State
from clothtrack.tracking.theta import Theta, cloth_parameters
from clothtrack.tracking.visible_alignment import VisibleAlignment

logger = logging.getLogger(__name__)

FINAL_STRENGTH = 1.0 - 1e-5
"""Strength of the pseudo-action that carries a final alignment out: just below 1, so that contacts,
stretch and table still win over the observation."""

SEEN_MOBILITY = 0.1
"""Mobility of a vertex that is seen when the cloth is taken apart: it is where it was measured."""


class FinalAlignment:
    """Slides a cloth that nobody holds to its outline, then aligns its visible vertices.

    Where the cloth passes through itself it is taken apart, before and after.
    """

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        config: TrackerConfig,
        align: VisibleAlignment,
        dynamics: ClothDynamics,
        *,
        device: str = "cpu",
    ) -> None:
        """Take what all actions share.

        Args:
            recording: its name for messages, and its table.
            mesh: the flat first mesh.
            config: rounds, slide, and how a correction is carried out.
            align: aligns visible vertices with the settings of the final alignment.
            dynamics: carries a correction out.
            device: "cpu" or "cuda:0".
        """
        self._name, self._table, self._mesh = recording.name, recording.table, mesh
        self._config, self._align, self._dynamics = config.final_alignment, align, dynamics
        self._untangle, self._device = Untangler(mesh, device=device), device

    def __call__(
        self, state: ClothState, theta: Theta, observation: Observation, held: bool
    ) -> tuple[ClothState, tuple[float, float]]:
        """The state that the next action starts from: aligned, at rest, contacts remembered.

        Args:
            state: the cloth at the last frame of an action.
            theta: its parameters, with which a correction is carried out.
            observation: the cloud of that frame.
            held: some picker still holds it: it is not slid.

        Returns:
            The state, and the objective [m^2] before and after; NaN where there was no cloud.
        """
        self._dynamics.solver.set_parameters(cloth_parameters(theta, self._dynamics.solver.mesh))
        if self._config.slide and not held:
            state = self._slid(state, observation)
        state = self._taken_apart(state)
        losses = (np.nan, np.nan)
        for _ in range(self._config.rounds):
            correction = self._align.aligned(state.positions[0], observation)
            if correction is None:
                break
            first = correction.losses[0] if np.isnan(losses[0]) else losses[0]
            losses = (first, correction.losses[1])
            state = self._corrected(state, correction)
        return self._taken_apart(state), losses

    def _slid(self, state: ClothState, observation: Observation) -> ClothState:
        """The cloth slid over the table as a whole until its outline fits; at rest."""
        positions = state.positions[0]
        if self._table is None or not np.isfinite(positions).all():
            return state
        moved = slide_to_outline(
            self._mesh, positions.astype(np.float64), observation, self._table, device=self._device
        )
        return self._at_rest(state, moved)

    def _corrected(self, state: ClothState, correction: Correction) -> ClothState:
        """The state after a correction: rolled there, or displaced at once; at rest."""
        config = self._config
        targets = state.positions + correction.displacement[None]
        if config.roll_s == 0.0:
            return self._at_rest(state, targets)
        strength = np.where(correction.attached, FINAL_STRENGTH, 0.0).astype(np.float32)
        pull = Attachment(targets.astype(np.float32), strength[None])
        return rolled_to(self._dynamics, state, pull, config.roll_s, self._name)

    def _taken_apart(self, state: ClothState) -> ClothState:
        """The state without passages through itself, as far as they can be undone; at rest.

        Contact must not remember sides that a passage had exchanged.
        """
        positions = state.positions[0]
        if not self._config.untangle or not np.isfinite(positions).all():
            return state
        mobility = np.where(self._align.sees(positions), SEEN_MOBILITY, 1.0)
        apart = self._untangle(positions, mobility=mobility, table=self._table)
        moved = (apart.positions != positions).any(axis=1)
        if not moved.any():
            return state
        memory = state.contacts.without(moved, self._mesh.faces)
        return self._at_rest(replace(state, contacts=memory), apart.positions)

    def _at_rest(
        self, state: ClothState, vertices: Float[np.ndarray, "*environments vertices 3"]
    ) -> ClothState:
        """The state with its vertices placed here [m], through whatever is in the way."""
        solver = self._dynamics.solver
        solver.restore(state)
        solver.place(vertices)
        solver.set_velocities(np.zeros_like(state.velocities))
        return solver.save()


def rolled_to(
    dynamics: ClothDynamics, state: ClothState, pull: Attachment, roll_s: float, name: str
) -> ClothState:
    """The cloth pulled somewhere by the dynamics, so that layers keep their sides; left at rest.

    Args:
        dynamics: with the cloth's parameters.
        state: where it starts; and where it stays if the roll-out diverges.
        pull: what is wanted where.
        roll_s: how long it may take [s].
        name: of the recording, for messages.
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
    """The ablation without TTO2: the cloth stays as the last frame left it."""
    return state, (np.nan, np.nan)
