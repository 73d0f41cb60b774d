"""Which pick-and-place comes next: try many in the dynamics, take the one that covers most.

Random shooting as in the paper; cross-entropy refinement and averaging over several hypotheses of
mesh or material are values of the same configuration.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.actions import (
    ActionSpace,
    PickPlace,
    SeenCloth,
    off_cloth,
    pick_weights,
    sample_actions,
    within_limits,
)
from clothtrack.planning.coarse_cloth import CoarseConfig, Coarsener
from clothtrack.planning.dynamics import PlannedCloth, PlanningDynamics
from clothtrack.planning.reward import CoverageMeasure, coverage

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class PlannerConfig:
    """How an action is chosen.

    Attributes:
        candidates: actions per round, beside doing nothing; 100 in the paper.
        refinements: rounds after the first, each of as many candidates around the best of all
            rounds before (cross-entropy); 0 is the paper's random shooting.
        elite: share of a round's candidates that the next round is drawn around.
        pick_spread_m: standard deviation of a refined pick around its elite [m], halved per round.
        place_spread_m: the same of the place [m].
        lift_spread_m: the same of the lift [m].
        reward: "exact" coverage, or the literature's "raster".
        within_picture: cloth that the camera would not see does not count as covering.
        caution: standard deviations over hypotheses and materials that are taken off the mean gain.
        strip_m: a place farther off the cloth is preferred, as if a strip of cloth this wide came
            along to it [m]; 0: what the dynamics promise counts alone. They promise too much for
            places on the cloth and beside it (docs/flattening.md).
        finalists: of several hypotheses and dynamics the first rates all candidates, and so many of
            the most promising are rated by all. 0: all rate all.
        look_ahead: so many of the most promising are judged by what could be done after them, too:
            the best of `second_candidates` from where each ends. 0: what comes at once counts.
        second_candidates: actions that are tried after each of those.
        space: which actions are tried.
        coarse: the mesh that is rolled out.
    """

    candidates: int = 100
    refinements: int = 0
    elite: float = 0.1
    pick_spread_m: float = 0.02
    place_spread_m: float = 0.03
    lift_spread_m: float = 0.02
    reward: CoverageMeasure = "exact"
    within_picture: bool = True
    caution: float = 0.0
    strip_m: float = 0.06
    finalists: int = 10
    look_ahead: int = 0
    second_candidates: int = 20
    space: ActionSpace = field(default_factory=ActionSpace)
    coarse: CoarseConfig = field(default_factory=CoarseConfig)

    def __post_init__(self) -> None:
        """Refuse what chooses nothing.

        Raises:
            InvalidConfigError: with the field and the value.
        """
        if self.candidates < 1 or self.refinements < 0:
            raise InvalidConfigError(
                f"candidates is {self.candidates} and refinements {self.refinements}; give at "
                "least 1 candidate and 0 refinements"
            )
        for name in ("finalists", "look_ahead"):
            if getattr(self, name) < 0:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; give 0 or more")
        if not 0.0 <= self.strip_m < float("inf"):
            raise InvalidConfigError(f"strip_m is {self.strip_m}; give 0 or more metres")
        if self.second_candidates < 1:
            raise InvalidConfigError(
                f"second_candidates is {self.second_candidates}; give at least 1"
            )
        if not 0.0 < self.elite <= 1.0:
            raise InvalidConfigError(f"elite is {self.elite}; it is a share, above 0 up to 1")
        if self.reward not in ("exact", "raster"):
            raise InvalidConfigError(f"reward is {self.reward!r}; choose 'exact' or 'raster'")


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
        gain_m2: coverage that it is expected to add [m^2]; with look_ahead, together with the next.
        candidates: every action that was tried.
        gains_m2: expected gain of each, less the caution [m^2].
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
        clock, cpu, config = time.perf_counter(), time.process_time(), self.config
        cloths = [self._coarsened(one, seen.table_height_m) for one in hypotheses]
        beliefs = [(cloth.flat, np.asarray(cloth.positions)) for cloth in cloths]
        weights = pick_weights(seen.cloud, beliefs)
        tried = sample_actions(seen, config.candidates, config.space, rng, weights=weights)
        every = cloths, self._dynamics
        judges = (cloths[:1], self._dynamics[:1]) if config.finalists else every
        worth = self._gains(tried, seen, *judges) + self._strips(tried, seen)
        for round_ in range(config.refinements):
            fresh = self._around_the_best(tried, worth, seen, round_, rng)
            tried = tried + fresh
            further = self._gains(fresh, seen, *judges) + self._strips(fresh, seen)
            worth = np.concatenate([worth, further])
        if judges is not every and len(cloths) * len(self._dynamics) > 1 and tried:
            worth = self._after_a_final(cloths, tried, worth, seen)
        if config.look_ahead and tried:
            worth = self._looking_ahead(cloths, tried, worth, seen, rng)
        gains = worth - self._strips(tried, seen)
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

    def _strips(self, tried: Sequence[PickPlace], seen: SeenCloth) -> Float[np.ndarray, " tried"]:
        """What each place is preferred by for lying off the cloth [m^2]."""
        return self.config.strip_m * off_cloth(seen, tried)

    def _after_a_final(
        self,
        cloths: Sequence[PlannedCloth],
        tried: Sequence[PickPlace],
        worth: Float[np.ndarray, " tried"],
        seen: SeenCloth,
    ) -> Float[np.ndarray, " tried"]:
        """Worth with that of the most promising as all hypotheses and dynamics see them [m^2].

        The best of many promises more than it keeps: it is the best for its luck, too. What did
        not come so far ranks behind all that did.
        """
        best = np.argsort(-worth, kind="stable")[: self.config.finalists]
        finalists = [tried[k] for k in best]
        told = self._gains(finalists, seen, cloths, self._dynamics) + self._strips(finalists, seen)
        return _judged_anew(worth, best, told)

    def _looking_ahead(
        self,
        cloths: Sequence[PlannedCloth],
        tried: Sequence[PickPlace],
        worth: Float[np.ndarray, " tried"],
        seen: SeenCloth,
        rng: np.random.Generator,
    ) -> Float[np.ndarray, " tried"]:
        """Worth of the most promising with the best that could come after each [m^2].

        What comes after is asked of the first dynamics and of the first hypothesis alone.
        """
        config, cloth = self.config, cloths[0]
        best = np.argsort(-worth, kind="stable")[: config.look_ahead]
        best = best[np.isfinite(worth[best])]
        ends = self._dynamics[0].predict(cloth, [tried[k] for k in best])
        told = np.array(worth[best])
        for number, end in enumerate(ends):
            after = replace(cloth, positions=end, fine=None, stands_for=None)
            shown = replace(seen, cloud=end)
            weights = pick_weights(end, [(cloth.flat, end)])
            next_ones = sample_actions(
                shown, config.second_candidates, config.space, rng, weights=weights
            )
            further = self._gains(next_ones, shown, [after], self._dynamics[:1])
            told[number] += max(0.0, float(further.max(initial=0.0)))
        return _judged_anew(worth, best, told)

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
                areas = coverage(ends, cloth.flat.faces, self.config.reward, camera)
                still = areas[0] if np.isfinite(areas[0]) else areas[np.isfinite(areas)].min(
                    initial=0.0
                )  # fmt: skip
                rows.append(areas[1:] - still)
        gains = np.array(rows)
        burst = ~np.isfinite(gains).all(axis=0)
        sound = np.where(np.isfinite(gains), gains, 0.0)
        total = sound.mean(axis=0) - self.config.caution * sound.std(axis=0)
        return np.where(burst, -np.inf, total)

    def _around_the_best(
        self,
        tried: Sequence[PickPlace],
        worth: Float[np.ndarray, " tried"],
        seen: SeenCloth,
        round_: int,
        rng: np.random.Generator,
    ) -> list[PickPlace]:
        """As many new candidates as a round has, drawn around the best so far."""
        config = self.config
        count = max(1, round(config.elite * config.candidates))
        best = np.argsort(-worth, kind="stable")[:count]
        if not len(best):
            return []
        shrink = 0.5**round_
        tree = cKDTree(seen.cloud[:, :2])
        found: list[PickPlace] = []
        for _ in range(5):
            wanted = config.candidates - len(found)
            if wanted <= 0:
                break
            around = [tried[k] for k in rng.choice(best, 2 * wanted)]
            noise = rng.standard_normal((len(around), 5)) * shrink
            aim = np.array([one.pick[:2] for one in around])
            aim = aim + config.pick_spread_m * noise[:, :2]
            picks = seen.cloud[tree.query(aim)[1]].astype(np.float64)
            ways = np.array([(one.place - one.pick)[:2] for one in around])
            places = picks[:, :2] + ways + config.place_spread_m * noise[:, 2:4]
            lifts = np.array([one.lift_m for one in around])
            lifts = np.clip(lifts + config.lift_spread_m * noise[:, 4], *config.space.lift_m)
            found += within_limits(seen, picks, places, lifts, config.space)
        return found[: config.candidates]

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


def _judged_anew(
    worth: Float[np.ndarray, " tried"],
    best: Int[np.ndarray, " best"],
    told: Float[np.ndarray, " best"],
) -> Float[np.ndarray, " tried"]:
    """The worth with that of the best as it is now; the others rank behind all of those."""
    anew = np.array(worth)
    if not len(best):
        return anew
    anew[best] = told
    others = np.setdiff1d(np.arange(len(worth)), best)
    anew[others] = np.minimum(worth[others], np.nextafter(told.min(), -np.inf))
    return anew
