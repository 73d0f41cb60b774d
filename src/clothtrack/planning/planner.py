"""Which pick-and-place comes next: try many in the dynamics, take the one that covers most.

Random shooting as in the paper (Sec. IV-B.2): sample actions, roll each out, take the best. Two
things are added: a preference for places off the cloth, and a mean over several hypotheses of mesh
or material.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count, Natural, NotNegative
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import (
    ActionSpace,
    PickPlace,
    SeenCloth,
    off_cloth,
    pick_weights,
    sample_actions,
)
from clothtrack.planning.coarse_cloth import CoarseConfig, Coarsener
from clothtrack.planning.planning_dynamics import PlannedCloth, PlanningDynamics
from clothtrack.planning.reward import coverage


@dataclass(frozen=True)
class PlannerConfig(Checked):
    """How an action is chosen.

    Attributes:
        candidates: actions that are tried, beside doing nothing; 100 in the paper.
        within_picture: cloth that the camera would not see does not count as covering.
        strip_m: a place farther off the cloth is preferred, as if a strip of cloth this wide came
            along to it [m]; 0: what the dynamics promise counts alone. They promise too much for
            places on the cloth and beside it (docs/flattening.md).
        finalists: of several hypotheses and dynamics the first rates all candidates, and so many of
            the most promising are rated by all. 0: all rate all.
        space: which actions are tried.
        coarse: the mesh that is rolled out.
    """

    candidates: Count = 100
    within_picture: bool = True
    strip_m: NotNegative = 0.06
    finalists: Natural = 10
    space: ActionSpace = field(default_factory=ActionSpace)
    coarse: CoarseConfig = field(default_factory=CoarseConfig)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One belief of where the cloth is.

    Attributes:
        flat: the garment at rest [m], with canonical coordinates.
        positions: its vertices now [m], world frame.
        kind: the garment.
    """

    flat: ClothMesh
    positions: Float[np.ndarray, "vertices 3"]
    kind: str


@dataclass(frozen=True, eq=False)
class Decision:
    """What was chosen, and from what.

    Attributes:
        action: the best; None when nothing beats doing nothing.
        gain_m2: coverage that it is expected to add [m^2].
        candidates: every action that was tried.
        gains_m2: expected gain of each [m^2].
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


class Planner:
    """Chooses actions for one garment after another; coarse meshes are kept between decisions."""

    def __init__(
        self, dynamics: Sequence[PlanningDynamics], config: PlannerConfig | None = None
    ) -> None:
        """Remember what to ask.

        Args:
            dynamics: one, or several whose answers are averaged, such as the simulator with
                several materials; with finalists the first alone chooses those.
            config: how to choose.

        Raises:
            InvalidConfigError: there are no dynamics.
        """
        if not dynamics:
            raise InvalidConfigError("no dynamics are given; a planner needs at least one")
        self.config = config or PlannerConfig()
        self._dynamics = tuple(dynamics)
        self._coarse: list[tuple[ClothMesh, Coarsener]] = []

    def decide(
        self, hypotheses: Sequence[Hypothesis], seen: SeenCloth, rng: np.random.Generator
    ) -> Decision:
        """Choose the next action.

        Args:
            hypotheses: where the cloth may be, the likeliest first; the gain is the mean over them.
            seen: what the camera sees of it: picks are there.
            rng: source of the candidates.

        Raises:
            InvalidConfigError: there is no hypothesis.
        """
        if not hypotheses:
            raise InvalidConfigError("no hypothesis of the cloth is given; reconstruct it first")
        clock, cpu = time.perf_counter(), time.process_time()
        cloths = [self._coarsened(belief, seen.table_height_m) for belief in hypotheses]
        beliefs = [(cloth.flat, np.asarray(cloth.positions)) for cloth in cloths]
        tried = sample_actions(
            seen, self.config.candidates, self.config.space, rng,
            weights=pick_weights(seen.cloud, beliefs),
        )  # fmt: skip
        strips = self.config.strip_m * off_cloth(seen, tried)
        worth = self._worth(tried, strips, seen, cloths)
        gains = worth - strips
        # A strip says which action, never that there should be one.
        improving = np.where(gains > 0.0, worth, -np.inf)
        best = int(np.argmax(improving)) if len(gains) else -1
        improves = best >= 0 and gains[best] > 0.0
        return Decision(
            action=tried[best] if improves else None,
            gain_m2=float(gains[best]) if improves else 0.0,
            candidates=tuple(tried),
            gains_m2=gains,
            worth_m2=worth,
            seconds=time.perf_counter() - clock,
            cpu_s=time.process_time() - cpu,
        )

    def _worth(
        self,
        tried: Sequence[PickPlace],
        strips: Float[np.ndarray, " tried"],
        seen: SeenCloth,
        cloths: Sequence[PlannedCloth],
    ) -> Float[np.ndarray, " tried"]:
        """Gain and strip of each action [m^2].

        With finalists, the first hypothesis and dynamics rate all actions, and all rate the most
        promising. These promise too much as the first alone rates them: the best of many is partly
        a chance error. The others rank behind them.
        """
        count = self.config.finalists
        if not count:
            return self._gains(tried, seen, cloths, self._dynamics) + strips
        worth = self._gains(tried, seen, cloths[:1], self._dynamics[:1]) + strips
        if len(cloths) * len(self._dynamics) == 1 or not tried:
            return worth
        best, others = np.split(np.argsort(-worth, kind="stable"), [count])
        finalists = [tried[k] for k in best]
        final = self._gains(finalists, seen, cloths, self._dynamics) + strips[best]
        worth[best] = final
        worth[others] = np.minimum(worth[others], np.nextafter(final.min(), -np.inf))
        return worth

    def _gains(
        self,
        actions: Sequence[PickPlace],
        seen: SeenCloth,
        cloths: Sequence[PlannedCloth],
        judges: Sequence[PlanningDynamics],
    ) -> Float[np.ndarray, " actions"]:
        """Coverage that each action adds to doing nothing [m^2], over hypotheses and dynamics."""
        if not actions:
            return np.zeros(0)
        camera = seen.camera if self.config.within_picture else None
        rows = []
        for cloth in cloths:
            for dynamics in judges:
                ends = dynamics.predict(cloth, [None, *actions])
                areas = coverage(ends, cloth.flat.faces, camera)
                still = areas[0] if np.isfinite(areas[0]) else areas[np.isfinite(areas)].min(
                    initial=0.0
                )  # fmt: skip
                rows.append(areas[1:] - still)
        gains = np.array(rows)
        finite = np.isfinite(gains)
        mean = np.where(finite, gains, 0.0).mean(axis=0)
        return np.where(finite.all(axis=0), mean, -np.inf)

    def _coarsened(self, belief: Hypothesis, table_height_m: float) -> PlannedCloth:
        """The coarse cloth of a hypothesis; the same flat garment gives the same mesh."""
        known = [coarsen for flat, coarsen in self._coarse if flat is belief.flat]
        coarsen = known[0] if known else Coarsener(belief.flat, belief.kind, self.config.coarse)
        if not known:
            self._coarse = [*self._coarse[-3:], (belief.flat, coarsen)]
        fine = np.asarray(belief.positions, dtype=np.float64)
        return PlannedCloth(
            coarsen.flat, coarsen(fine), table_height_m, fine=fine, stands_for=coarsen.stands_for
        )
