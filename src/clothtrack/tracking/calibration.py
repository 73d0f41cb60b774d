"""Which cloth is this? Parameters of the simulator from one recorded action (Sec. III-B.1).

Every candidate is rolled out open loop, with the picker but without pseudo-actions, and its
visible vertices are compared with the observed cloud at the end of the action. Candidates run as
environments of one batch. The full grid is the paper's; successive halving and coordinate descent
reach the same Chamfer distance within a few percent for a fraction of the roll-outs.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count, NotNegative, Share
from clothtrack.tracking.theta import PARAMETERS, Theta, check_parameter
from clothtrack.tracking.tracked_trajectory import Calibration

Method = Literal["none", "grid", "halving", "descent"]
Judge = Literal["open_loop", "tracking"]

Score = Callable[
    [Float[np.ndarray, "candidates parameters"], float], Float[np.ndarray, " candidates"]
]
"""Chamfer [m^2] of candidates, columns as PARAMETERS, rolled through a share of the action."""

Candidate = tuple[float, ...]
"""A value for each searched parameter, in the order of the axes."""

OFFSET_STEPS = 5
"""Heights of the grasp to try, spread over the uncertainty that the recording states; without one
the offset is not searched."""

BATCH = 36
"""Most environments in one batch: it bounds the memory of a search, however many candidates."""

HALVING_RATIO = 3
"""One in so many candidates survives a rung of successive halving, as is usual for it."""


def _default_axes() -> dict[str, tuple[float, ...]]:
    return {
        "bend_compliance": (1e-2, 1.0, 100.0),
        "table_friction": (0.3, 1.0, 3.0),
        "particle_friction": (0.3, 1.0),
    }


@dataclass(frozen=True)
class CalibrationConfig(Checked):
    """What is searched, and how.

    Attributes:
        method: "none", "grid" (the paper's), "halving" (successive halving on prefixes of the
            action) or "descent" (coordinate descent from the previous action's optimum).
        judge: "open_loop" (the paper's): how near an uncorrected roll-out comes to the clouds; or
            "tracking": how well the outline of the mesh fits when the whole action is tracked
            with the candidate. The second follows the true error far better and costs a
            tracking pass per candidate.
        axes: values to try for each searched parameter; the others keep the tracker's value.
            The paper searches stiffness (5), table friction (6) and particle friction (6): 180
            combinations printed, 125 stated.
        rank: share of the candidates that score better than the one that is taken: 0 takes the
            best; anything else asks how much tracking makes up for a bad calibration.
        sweeps: most passes over the axes in coordinate descent.
        enough: coordinate descent ends as soon as its best scores no worse than this; judged by
            tracking, 0.03 leaves most easy actions at one pass. 0: never.
        clearly: coordinate descent leaves a candidate only for one whose score is lower by this
            share of it. What differs less is chance, and would be carried on to the next action.
    """

    method: Method = "descent"
    judge: Judge = "open_loop"
    axes: Mapping[str, tuple[float, ...]] = field(default_factory=_default_axes)
    rank: Share = 0.0
    sweeps: Count = 2
    enough: NotNegative = 0.0
    clearly: Share = 0.0

    def __post_init__(self) -> None:
        """Refuse axes that are empty and values that cannot be meant.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        self._check_axes()

    def _check_axes(self) -> None:
        for name, values in self.axes.items():
            if name not in PARAMETERS:
                raise InvalidConfigError(
                    f"calibration: unknown parameter {name!r}; known are {', '.join(PARAMETERS)}"
                )
            if not values:
                raise InvalidConfigError(f"calibration: axis {name!r} has no value to try")
            for value in values:
                check_parameter(name, value)
        if self.judge == "open_loop" and "held_layers" in self.axes:
            raise InvalidConfigError(
                "calibration: held_layers cannot be searched open loop; set judge to 'tracking'"
            )

    def with_grasp_offset(self, uncertainty_m: float) -> "CalibrationConfig":
        """The same search, with the height of the grasp within this distance [m] of the tip.

        Open-loop roll-outs cannot tell a sideways offset from friction and stiffness: searching it
        too made tracking worse.
        """
        if uncertainty_m <= 0.0 or self.method == "none":
            return self
        values = tuple(np.linspace(-uncertainty_m, uncertainty_m, OFFSET_STEPS).tolist())
        # The offset matters most: descent meets it before the properties of the cloth.
        return replace(self, axes={"grasp_offset_z_m": values, **self.axes})

    @property
    def size(self) -> int:
        """Number of combinations in the full grid."""
        return int(np.prod([len(values) for values in self.axes.values()]))

    @property
    def passes(self) -> int:
        """Passes over an action to reckon with: the chosen one, or a first sweep of the search."""
        if self.method == "none" or self.judge == "open_loop":
            return 1
        if self.method == "descent":
            return 1 + sum(len(values) - 1 for values in self.axes.values())
        return self.size


def calibrate(
    score: Score | None, start: Theta, config: CalibrationConfig
) -> tuple[dict[str, float], Calibration]:
    """Find the parameters whose open-loop roll-out ends nearest to the last cloud.

    Args:
        score: rolls candidates out and returns their Chamfer distance [m^2]; None keeps the start.
        start: value of every parameter before the search; the previous action's optimum.
        config: axes and method.

    Returns:
        The chosen value of every parameter, and the record of all candidates.
    """
    if score is None or config.method == "none":
        return dict(start), Calibration.none()
    names = tuple(config.axes)
    counted = _Counted(score, start, names)
    reached = None
    if names:
        search = {"grid": _grid, "halving": _halving, "descent": _descent}[config.method]
        reached = search(counted, config)
    candidates = np.array(list(counted.scores), float).reshape(len(counted.scores), len(names))
    scores = np.array(list(counted.scores.values()), float)
    best = ranked(scores, config.rank) if len(scores) else -1
    if reached is not None and config.rank == 0.0:
        best = list(counted.scores).index(reached)
    chosen = dict(start)
    if best >= 0:
        chosen |= dict(zip(names, candidates[best].tolist(), strict=True))
    return chosen, Calibration(
        config.method, names, candidates, scores, best, counted.roll_outs, config.judge
    )


def ranked(scores: Float[np.ndarray, " candidates"], rank: float) -> int:
    """The candidate that a share `rank` of the other finite ones outscores; 0 is the best."""
    order = np.argsort(scores, kind="stable")
    last = max(0, int(np.isfinite(scores).sum()) - 1)
    return int(order[round(rank * last)])


class _Counted:
    """Scores by candidate, each rolled out once; counts what was spent."""

    def __init__(self, score: Score, start: Mapping[str, float], names: tuple[str, ...]) -> None:
        self._score, self._start, self._names = score, start, names
        self.scores: dict[tuple[float, ...], float] = {}
        self.roll_outs = 0.0

    def __call__(
        self, candidates: Sequence[tuple[float, ...]], share: float | int = 1.0
    ) -> np.ndarray:
        fresh = [c for c in dict.fromkeys(candidates) if share < 1.0 or c not in self.scores]
        results = {}
        for first in range(0, len(fresh), BATCH):
            part = fresh[first : first + BATCH]
            values = self._score(self._complete(part), share)
            # An exploded candidate is the worst one, not an error.
            values = np.where(np.isfinite(values), values, np.inf)
            results |= dict(zip(part, values.tolist(), strict=True))
            self.roll_outs += share * len(part)
        if share >= 1.0:
            self.scores |= results
            results = self.scores
        return np.array([results[c] for c in candidates])

    def start_on(self, axes: Mapping[str, tuple[float, ...]]) -> tuple[float, ...]:
        """The axis values nearest to the start (in ratio where both are positive)."""
        return tuple(_nearest(values, self._start[name]) for name, values in axes.items())

    def _complete(self, candidates: Sequence[tuple[float, ...]]) -> np.ndarray:
        rows = np.tile([self._start[name] for name in PARAMETERS], (len(candidates), 1))
        rows[:, [PARAMETERS.index(name) for name in self._names]] = candidates
        return rows


def _nearest(values: tuple[float, ...], wanted: float) -> float:
    if wanted > 0 and min(values) > 0:
        return min(values, key=lambda value: abs(np.log(value / wanted)))
    return min(values, key=lambda value: abs(value - wanted))


def _grid(score: _Counted, config: CalibrationConfig) -> None:
    score(list(itertools.product(*config.axes.values())))


def _halving(score: _Counted, config: CalibrationConfig) -> None:
    candidates = list(itertools.product(*config.axes.values()))
    rungs = max(0, int(np.log(len(candidates)) / np.log(HALVING_RATIO)) - 1)
    for rung in range(rungs, -1, -1):
        scores = score(candidates, HALVING_RATIO**-rung)
        keep = max(1, len(candidates) // HALVING_RATIO)
        candidates = [candidates[i] for i in np.argsort(scores, kind="stable")[:keep]]


def _descent(score: _Counted, config: CalibrationConfig) -> Candidate:
    """The candidate that no other on its axes is clearly better than."""
    best = score.start_on(config.axes)
    for _ in range(config.sweeps):
        before = best
        for column, values in enumerate(config.axes.values()):
            if config.enough > 0.0 and score([best])[0] <= config.enough:
                return best
            line = [(*best[:column], value, *best[column + 1 :]) for value in values]
            best = _clearly_best(line, score(line), best, config.clearly)
        if best == before:
            break
    return best


def _clearly_best(
    line: list[Candidate], scores: Float[np.ndarray, " line"], now: Candidate, clearly: float
) -> Candidate:
    lowest = int(np.argmin(scores))
    better = scores[lowest] <= (1.0 - clearly) * scores[line.index(now)]
    return line[lowest] if better else now
