"""Which pick-and-place comes next: try many in the dynamics, take the one that covers most.

Random shooting as in the paper (Sec. IV-B.2): sample actions, roll each out, take the best. A
preference for places off the cloth is added.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from clothtrack.files.bounds import Checked, Count, NotNegative
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import (
    ActionSpace,
    PickPlace,
    SeenCloth,
    off_cloth,
    pick_weights,
    sample_actions,
)
from clothtrack.planning.coarse_cloth import Coarsener
from clothtrack.planning.planning_dynamics import PlannedCloth, PlanningDynamics
from clothtrack.planning.reward import coverage

_BOTH_ORDERS = 30
"""So many actions, the best with the layers as they are believed to lie, are rolled out with the
opposite order, too. Of 15 decisions all took one of the best 26 of 100."""


@dataclass(frozen=True)
class PlannerConfig(Checked):
    """How an action is chosen.

    Attributes:
        candidates: actions that are tried, beside doing nothing; 100 in the paper.
        strip_m: a place farther off the cloth is preferred, as if a strip of cloth this wide came
            along to it [m]; 0: what the dynamics promise counts alone. They promise too much for
            places on the cloth and beside it (docs/flattening.md).
        space: which actions are tried.
    """

    candidates: Count = 100
    strip_m: NotNegative = 0.09
    space: ActionSpace = field(default_factory=ActionSpace)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """What is believed of the cloth.

    Attributes:
        flat: the garment at rest [m], with canonical coordinates.
        positions: its vertices now [m], world frame.
        kind: the garment.
        opposite: where they are if the layers lie in the opposite order [m], which is held to be as
            likely; None: it is not.
    """

    flat: ClothMesh
    positions: Float[np.ndarray, "vertices 3"]
    kind: str
    opposite: Float[np.ndarray, "vertices 3"] | None = None


@dataclass(frozen=True, eq=False)
class Decision:
    """What was chosen, and from what.

    Attributes:
        action: the best; None when no action keeps the limits.
        gain_m2: coverage that it is expected to add [m^2].
        candidates: every action that was tried, the best first.
        gains_m2: expected gain of each [m^2]; of the best it is the mean over both orders of the
            layers, where either is as likely.
        worth_m2: what each is chosen by: its gain, and the strip to its place [m^2].
        seconds: wall-clock time of the decision [s].
        cpu_s: processor time of the decision [s].
    """

    action: PickPlace | None
    gain_m2: float
    candidates: tuple[PickPlace, ...] = ()
    gains_m2: Float[np.ndarray, " candidates"] = field(default_factory=lambda: np.zeros(0))
    worth_m2: Float[np.ndarray, " candidates"] = field(default_factory=lambda: np.zeros(0))
    seconds: float = 0.0
    cpu_s: float = 0.0


def ranked(
    gains_m2: Float[np.ndarray, " actions"], worth_m2: Float[np.ndarray, " actions"]
) -> Int[np.ndarray, " actions"]:
    """Return the numbers of the actions, the best first: those that promise a gain, by worth.

    Cloth that is not flat can be flattened: where the mesh promises nothing, it is wrong, and what
    is worth most is done all the same.
    """
    return np.lexsort((-worth_m2, gains_m2 <= 0.0))


class Planner:
    """Chooses actions for one garment after another; coarse meshes are kept between decisions."""

    def __init__(self, dynamics: PlanningDynamics, config: PlannerConfig | None = None) -> None:
        """Choose by what these dynamics predict."""
        self.config = config or PlannerConfig()
        self._dynamics = dynamics
        self._coarse: list[tuple[ClothMesh, Coarsener]] = []

    def decide(self, hypothesis: Hypothesis, seen: SeenCloth, rng: np.random.Generator) -> Decision:
        """Choose the next action.

        Args:
            hypothesis: where the cloth is believed to be.
            seen: what the camera sees of it: picks are there.
            rng: source of the candidates.
        """
        clock, cpu = time.perf_counter(), time.process_time()
        cloth = self._coarsened(hypothesis, seen.table_height_m)
        tried = sample_actions(
            seen, self.config.candidates, self.config.space, rng,
            weights=pick_weights(seen.cloud, cloth.flat, cloth.positions),
        )  # fmt: skip
        strips = self.config.strip_m * off_cloth(seen, tried)
        gains = self.gains(hypothesis, seen, tried)
        order = ranked(gains, gains + strips)
        if hypothesis.opposite is not None:
            best, others = np.split(order, [_BOTH_ORDERS])
            turned = replace(hypothesis, positions=hypothesis.opposite)
            gains[best] += self.gains(turned, seen, [tried[k] for k in best])
            gains[best] /= 2.0
            best = best[ranked(gains[best], (gains + strips)[best])]
            order = np.concatenate([best, others])
        worth = gains + strips
        order = order[np.isfinite(gains[order])]
        return Decision(
            action=tried[order[0]] if len(order) else None,
            gain_m2=float(gains[order[0]]) if len(order) else 0.0,
            candidates=tuple(tried[k] for k in order),
            gains_m2=gains[order],
            worth_m2=worth[order],
            seconds=time.perf_counter() - clock,
            cpu_s=time.process_time() - cpu,
        )

    def gains(
        self, hypothesis: Hypothesis, seen: SeenCloth, actions: Sequence[PickPlace]
    ) -> Float[np.ndarray, " actions"]:
        """Return the coverage [m^2] that each action adds to doing nothing, of one order."""
        cloth = self._coarsened(hypothesis, seen.table_height_m)
        if not actions:
            return np.zeros(0)
        ends = self._dynamics.predict(cloth, [None, *actions])
        areas = coverage(ends, cloth.flat.faces, seen.camera)
        return areas[1:] - (areas[0] if np.isfinite(areas[0]) else 0.0)

    def _coarsened(self, belief: Hypothesis, table_height_m: float) -> PlannedCloth:
        """Return the coarse cloth where it is believed to be; one mesh for one flat garment."""
        known = [coarsen for flat, coarsen in self._coarse if flat is belief.flat]
        coarsen = known[0] if known else Coarsener(belief.flat, belief.kind, self._dynamics.coarse)
        if not known:
            self._coarse = [*self._coarse[-3:], (belief.flat, coarsen)]
        fine = np.asarray(belief.positions, dtype=np.float64)
        return PlannedCloth(
            coarsen.flat, coarsen(fine), table_height_m, fine=fine, stands_for=coarsen.stands_for
        )
