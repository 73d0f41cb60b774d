"""One word about a label or a trajectory: trust, look or reject, and why.

The one place that decides. It knows what was observed, and no truth: the expected error of the
label (`evaluation.label_quality`) and what that error cannot tell.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from clothtrack.evaluation.label_quality import LabelQuality

Word = Literal["trust", "look", "reject"]
WORDS: tuple[Word, ...] = get_args(Word)
"""From the best to the worst."""

TRUSTED_MM = 8.0
"""Largest expected error [mm] of a label that is trusted unseen. On the benchmark the true error
differs from it by a factor of 1.18, and so stays under 10 mm: the reach of a tip sideways, within
which a pick finds the cloth that it is meant for (`tracking.picking`)."""

LARGEST_MM = 16.0
"""Expected error [mm] above which a label is rejected. The model was fitted on labels whose true
errors lie between 1.4 and 12.3 mm: what is expected beyond is only known to be larger."""

TORN = 0.1
"""Change of length that 95 % of the edges stay under in a label that is trusted. A mesh that is
torn to its cloud has the right outline, and no label that the model was fitted on was torn. Nine of
ten labels of the benchmark stay below 0.018 (docs/label_quality.md)."""


@dataclass(frozen=True)
class Verdict:
    """What to do with a label or with a trajectory.

    Attributes:
        word: "trust": use it; "look": look at it first; "reject": do not use it.
        reason: what decided, in words.
        expected_error_m: mean vertex error to expect [m]; NaN where nothing was seen.
    """

    word: Word
    reason: str
    expected_error_m: float

    def __str__(self) -> str:
        """The verdict for a person, in one line."""
        return f"{self.word}: {self.reason}"


def verdict(label: LabelQuality) -> Verdict:
    """What to do with one label."""
    expected = label.expected_error_mm
    if not math.isfinite(expected):
        return Verdict("reject", "nothing of the cloth was seen at its end", math.nan)
    text = f"expected error {expected:.1f} mm"
    if expected > LARGEST_MM:
        return Verdict("reject", f"{text} (at most {LARGEST_MM:g})", 1e-3 * expected)
    if expected > TRUSTED_MM:
        reason = f"{text} (trusted up to {TRUSTED_MM:g})"
        return Verdict("look", reason, 1e-3 * expected)
    strain = label.evidence.edge_strain_p95
    if strain > TORN:
        reason = f"{text}, but edges are stretched by {100 * strain:.0f} % (at most {100 * TORN:g})"
        return Verdict("look", reason, 1e-3 * expected)
    return Verdict("trust", text, 1e-3 * expected)


def trajectory_verdict(labels: Sequence[LabelQuality]) -> Verdict:
    """What to do with a trajectory: what its worst label deserves; errors are handed on."""
    if not labels:
        return Verdict("look", "no action, so that no mesh was judged", math.nan)
    worst, action = max(
        ((verdict(label), label.action) for label in labels),
        key=lambda one: (WORDS.index(one[0].word), _or_infinite(one[0].expected_error_m)),
    )
    if len(labels) == 1:
        return worst
    reason = f"{worst.reason}, after action {action + 1} of {len(labels)}"
    return Verdict(worst.word, reason, worst.expected_error_m)


def _or_infinite(value: float) -> float:
    return value if math.isfinite(value) else math.inf
