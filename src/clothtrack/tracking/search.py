"""Parameter search: grid and coordinate descent (paper, Sec. III-B.1).

A proposal is a generator. It yields lists of candidates, receives the score of each, and returns
the candidate that it chooses. It does not know how candidates are scored.
"""

import itertools
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count, NotNegative
from clothtrack.tracking.theta import PARAMETERS, Theta, check_parameter
from clothtrack.tracking.tracked_trajectory import Calibration

SearchMethod = Literal["none", "grid", "descent", "tracking"]

Values = tuple[float | int, ...]
"""A value for each searched parameter, in the order of the axes."""

Axes = Mapping[str, tuple[float | int, ...]]
"""Values to try, by parameter."""

Proposal = Generator[list[Values], list[float], Values]
"""Yields candidates, receives their scores, returns the chosen one."""

_OFFSET_STEPS = 5
"""Number of grasp heights to try, spread over the uncertainty that the recording states; without
one the offset is not searched."""


def _axes() -> dict[str, tuple[float | int, ...]]:
    return {
        # One layer or all of them: a few pick-and-places do not stack more than eight.
        "held_layers": (1, 8),
        "table_friction": (0.2, 0.5, 1.5),
        # A real T-shirt is stiffer than the cloth of the benchmark.
        "bend_compliance": (0.1, 1.0, 4.0),
        "particle_friction": (0.2, 0.5),
    }


@dataclass(frozen=True)
class SearchConfig(Checked):
    """Settings of the parameter search for each action.

    Attributes:
        method: "tracking": coordinate descent over candidates that are tracked to the end of the
            action, scored by the outline of the mesh; "descent": the same over open-loop roll-outs,
            scored by the last cloud; "grid": all combinations, open loop (the paper); "none".
        axes: values to try for each searched parameter; the others keep their value. The paper
            searches stiffness (5), table friction (6) and particle friction (6): it prints 180
            combinations and states 125.
        sweeps: maximum passes of coordinate descent over the axes.
        stop_score: the search ends at a tracked candidate whose outline misses at most this share
            of the cloth. Most easy actions then need one candidate. 0: never.
    """

    method: SearchMethod = "tracking"
    axes: Axes = field(default_factory=_axes)
    sweeps: Count = 2
    stop_score: NotNegative = 0.03

    def __post_init__(self) -> None:
        """Reject empty axes and invalid values.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        super().__post_init__()
        for name, values in self.axes.items():
            if name not in PARAMETERS:
                raise InvalidConfigError(
                    f"search: unknown parameter {name!r}; known are {', '.join(PARAMETERS)}"
                )
            if not values:
                raise InvalidConfigError(f"search: axis {name!r} has no value to try")
            for value in values:
                check_parameter(name, value)
        if self.method in ("grid", "descent") and "held_layers" in self.axes:
            raise InvalidConfigError(
                "search: held_layers cannot be searched open loop; set search.method to 'tracking'"
            )

    def with_grasp_offset(self, uncertainty_m: float) -> "SearchConfig":
        """Return the same search with the height of the grasp within this distance [m] of the tip.

        Open-loop roll-outs cannot tell a sideways offset from friction and stiffness. Searching it
        too made tracking worse.
        """
        if uncertainty_m <= 0.0 or self.method == "none":
            return self
        values = tuple(np.linspace(-uncertainty_m, uncertainty_m, _OFFSET_STEPS).tolist())
        # The offset matters most, so descent searches it before the properties of the cloth.
        return replace(self, axes={"grasp_offset_z_m": values, **self.axes})

    def expected_candidates(self, start: Theta) -> int:
        """Return the expected number of candidates for the progress display.

        It is one, or the number in a first sweep from this start if no candidate is better.
        """
        if self.method != "tracking" or not self.axes:
            return 1
        proposal = coordinate_descent(self.axes, start, sweeps=1, min_improvement=1.0)
        asked, tried = next(proposal), set[Values]()
        while True:
            tried.update(asked)
            try:
                asked = proposal.send([1.0] * len(asked))
            except StopIteration:
                return len(tried)


def grid(axes: Axes) -> Proposal:
    """Propose every combination; choose the best."""
    candidates = list(itertools.product(*axes.values()))
    scores = yield candidates
    return candidates[int(np.argmin(scores))]


def coordinate_descent(
    axes: Axes,
    start: Theta,
    *,
    sweeps: int,
    stop_score: float = 0.0,
    min_improvement: float = 0.0,
) -> Proposal:
    """Propose the values of one axis after another; choose a minimum along every axis."""
    best = tuple(_nearest(values, getattr(start, name)) for name, values in axes.items())
    for _ in range(sweeps):
        before = best
        for column, values in enumerate(axes.values()):
            if stop_score > 0.0 and (yield [best])[0] <= stop_score:
                return best
            line = [(*best[:column], value, *best[column + 1 :]) for value in values]
            scores = yield line
            lowest = int(np.argmin(scores))
            if scores[lowest] <= (1.0 - min_improvement) * scores[line.index(best)]:
                best = line[lowest]
        if best == before:
            break
    return best


def _nearest(values: tuple[float | int, ...], wanted: float | int) -> float | int:
    """Return the nearest value, by ratio if all are positive."""
    if wanted > 0 and min(values) > 0:
        return min(values, key=lambda value: abs(np.log(value / wanted)))
    return min(values, key=lambda value: abs(value - wanted))


class Scores:
    """Scores of candidates, each scored once, and the record of the search."""

    def __init__(self, axes: Axes) -> None:
        """Begin without scores."""
        self._axes = axes
        self._scores: dict[Values, float] = {}

    def __getitem__(self, values: Values) -> float:
        """Return the score of a candidate; infinite if its simulation exploded."""
        return self._scores[values]

    def add(self, values: Values, score: float) -> None:
        """Store a score. A candidate that exploded gets the worst score and raises no error."""
        self._scores[values] = score if np.isfinite(score) else np.inf

    def missing(self, asked: Sequence[Values]) -> list[Values]:
        """Return the candidates without a score, each once."""
        return [values for values in dict.fromkeys(asked) if values not in self._scores]

    def record(
        self,
        method: str,
        judge: str,
        chosen: Values,
        spread_m: Float[np.ndarray, " vertices"] | None = None,
    ) -> Calibration:
        """Return the record of the search.

        Args:
            spread_m: spread of the candidates' final positions at each vertex [m].
        """
        candidates = np.array(list(self._scores), float).reshape(-1, len(self._axes))
        return Calibration(
            method,
            tuple(self._axes),
            candidates,
            np.array(list(self._scores.values()), float),
            list(self._scores).index(chosen),
            float(len(self._scores)),
            judge,
            np.zeros(0) if spread_m is None else spread_m,
        )

    def theta(self, start: Theta, values: Values) -> Theta:
        """Return `start` with the values of a candidate."""
        return replace(start, **dict(zip(self._axes, values, strict=True)))
