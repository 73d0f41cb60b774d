"""dyn(x, a): the motion of the cloth while a picker moves, used as the tracker's dynamics."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from clothtrack.simulation.picker_action import HeldMotion, PickerAction
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment, ClothState, pull_rate, pull_strength

_PICKER_STEP_M = 0.005
"""Longest motion of a held vertex in one step [m]."""

LONGEST_STEP_S = 0.05
"""Longest step [s]."""


@dataclass(frozen=True, eq=False)
class RollOut:
    """Result of a roll-out.

    Attributes:
        positions: the final vertices [m].
        highest_speed: highest speed of a free vertex during the roll-out, before the limit [m/s].
        started_at: the initial vertices [m].
        exact: whether it used the substeps of the solver instead of longer ones.
    """

    state: ClothState
    positions: Float32[np.ndarray, "environments vertices 3"]
    highest_speed: Float[np.ndarray, " environments"]
    started_at: Float32[np.ndarray, "environments vertices 3"]
    exact: bool = True


@dataclass(frozen=True, eq=False)
class ClothDynamics:
    """The solver as a function of state and action.

    Attributes:
        solver: steps the cloth; its own state is overwritten by every roll-out.
        velocity_kept: after a pseudo-action every vertex gets this share of its mean velocity over
            the roll-out, (x_new - x_old) / duration, because the velocity of the last substep would
            contain the energy of the pull. A value below 1 also keeps observation noise from
            becoming momentum.
        prediction_coarseness: substeps of a prediction, which is only used for alignment, are this
            many times as long as those of an accepted roll-out.
    """

    solver: ClothSolver
    velocity_kept: float = 1.0
    prediction_coarseness: int = 1

    def roll_out(
        self,
        state: ClothState | None,
        motion: HeldMotion | None,
        duration_s: float,
        pseudo: Attachment | None = None,
        *,
        coarseness: int = 1,
    ) -> RollOut:
        """Simulate the cloth for a given duration.

        Args:
            duration_s: duration [s].
            pseudo: targets of observed vertices at the end. Held vertices (strength 1) approach
                their targets in a straight line; softer targets pull from the start. Vertices that
                a picker holds follow the picker.
        """
        solver = self.solver
        if state is not None:
            solver.restore(state)
        before = solver.positions
        steps = self._steps(before, motion, duration_s)
        highest = np.zeros(solver.environments)
        for index in range(1, steps + 1):
            attachment = _attachment(before, motion, pseudo, index, steps)
            speed = solver.step(duration_s / steps, attachment, coarseness=coarseness)
            highest = np.maximum(highest, speed)
        positions = solver.positions
        if pseudo is not None:
            solver.set_velocities(self.velocity_kept / duration_s * (positions - before))
        return RollOut(solver.save(), positions, highest, before, exact=coarseness == 1)

    def __call__(
        self, state: ClothState, action: PickerAction, pseudo_action: Attachment | None = None
    ) -> RollOut:
        """Return dyn(x, a) or dyn(x, a, a~) of Algorithm 1."""
        return self.roll_out(state, action.motion, action.duration_s, pseudo_action)

    def predict(self, state: ClothState, action: PickerAction) -> RollOut:
        """Return dyn(x, a) with the configured coarseness; use it only for alignment."""
        return self.roll_out(
            state, action.motion, action.duration_s, coarseness=self.prediction_coarseness
        )

    def _steps(
        self,
        before: Float32[np.ndarray, "environments vertices 3"],
        motion: HeldMotion | None,
        duration_s: float,
    ) -> int:
        way = 0.0
        if motion is not None and len(motion.vertices):
            # A held vertex may first have to move to the start of its path.
            gap = np.linalg.norm(before[:, motion.vertices] - motion.at(0.0), axis=-1).max()
            way = motion.longest_path_m + float(gap)
        return max(
            1,
            math.ceil(duration_s / LONGEST_STEP_S - 1e-6),
            math.ceil(way / _PICKER_STEP_M - 1e-6),
        )


def _attachment(
    before: Float32[np.ndarray, "environments vertices 3"],
    motion: HeldMotion | None,
    pseudo: Attachment | None,
    index: int,
    steps: int,
) -> Attachment | None:
    """Return the attachment during step `index` of `steps`, counted from 1."""
    if motion is None and pseudo is None:
        return None
    held = motion.at(index / steps) if motion is not None else None
    sources = [len(pseudo.targets), len(pseudo.strength)] if pseudo is not None else [1]
    # A held target is approached from where the vertex was, so it needs every environment.
    placed = pseudo is not None and steps > 1 and bool((np.asarray(pseudo.strength) >= 1).any())
    environments = max(*sources, len(held) if held is not None else 1, len(before) if placed else 1)
    vertices = before.shape[1]
    targets = np.zeros((environments, vertices, 3))
    strength = np.zeros((environments, vertices))
    if pseudo is not None:
        strength[:] = pseudo.strength
        targets[:] = pseudo.targets
        if placed:
            way = before + (targets - before) * (index / steps)
            targets = np.where(strength[..., None] >= 1.0, way, targets)
        soft = (strength > 0.0) & (strength < 1.0)
        # Use the same spring in every step: its rate is that of the whole roll-out.
        strength[soft] = pull_strength(pull_rate(strength[soft], 1.0), 1.0 / steps)
    if motion is not None:
        targets[:, motion.vertices] = held
        strength[:, motion.vertices] = 1.0
    return Attachment(targets, strength)
