"""Verdicts on labels, trajectories and the mesh of a picture: trust, look or reject, and why.

Only this module decides. It uses observations and no truth. All evidence has a name, a measure and
a limit (`LIMITS`); the findings of the recording's checks are evidence, too.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from clothtrack._shown import html_table, short_repr
from clothtrack.evaluation.label_quality import (
    LabelQuality,
    Misplaced,
    judge_labels,
    left_behind,
)
from clothtrack.reconstruction.agreement import Agreement
from clothtrack.reconstruction.from_picture import NetworkMesh
from clothtrack.recordings.geometry_checks.checks import check_geometry
from clothtrack.recordings.geometry_checks.finding import Finding, ObservedFrames
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

Word = Literal["trust", "look", "reject"]
WORDS: tuple[Word, ...] = get_args(Word)
"""From the best to the worst."""


@dataclass(frozen=True)
class Limit:
    """Limits of a measure.

    Attributes:
        unit: unit of the measure: "m", or "" for a plain number.
        look: value above which the label must be looked at first.
        reject: value above which the label must not be used.
        remedy: command that helps; NAME.zarr and RECORDING stand for the files.
        named: whether the reason includes the limit, in mm, or in percent for plain numbers.
    """

    unit: str
    look: float
    reject: float = math.inf
    remedy: str = "clothtrack view NAME.zarr"
    named: bool = False


_OTHER_INPUT = ""  # It depends on what was given (`_other_input`).
_OTHER_PICTURE = "spread the cloth a little, and take another picture"

LIMITS: Mapping[str, Limit] = {
    # On the benchmark the true error differs from the expected one by a factor of 1.18. At 8 mm it
    # stays under 10 mm, within which a pick finds the intended cloth (`tracking.picking`). The
    # model was fitted on errors up to 12.3 mm; beyond 16 it only knows that the error is larger.
    "expected error": Limit("m", 0.008, 0.016, named=True),
    # A mesh that is stretched to fit its cloud has the right outline. Nine of ten labels of the
    # benchmark stay below 0.018 (docs/label_quality.md).
    "stretched edges": Limit("", 0.1),
    # Share of the cloth (`label_quality.Misplaced`).
    "misplaced part": Limit("", 0.02, 0.5),
    # The same share, for cloth that moves after an action while the mesh rests.
    "left behind": Limit("", 0.04, 0.5, "add the missing action to recording.json: actions"),
    "pickers that hold nothing": Limit("", 0.0, remedy="clothtrack inspect RECORDING"),
    # For the mesh of one picture; chosen on simulated states of seed 77 (docs/results.md).
    # 1 - intersection over union.
    "silhouette": Limit("", 0.10, 0.25, _OTHER_INPUT, named=True),
    # These three are relative to the longer side, because the network learned from garments of all
    # sizes.
    "visible surface over side": Limit("", 0.025, 0.05, _OTHER_INPUT, named=True),
    "spread over turns": Limit("", 0.03, 0.1, _OTHER_PICTURE, named=True),
    "expected error over side": Limit("", 0.06, 0.1, _OTHER_PICTURE, named=True),
    # 1 - mean confidence of the correspondences; without it 4 of 45 trusted states are wrong.
    "unsure correspondences": Limit("", 0.45, remedy=_OTHER_PICTURE, named=True),
}
"""Evidence from tracking and reconstruction. Contradictions within a recording are evidence, too
(`recordings.geometry_checks`), and each such finding is above its limit."""

_UNSEEN = {"visible surface over side": "no part of the mesh is visible in the picture"}
"""Meaning of a NaN measure, where it differs from the default."""


@dataclass(frozen=True)
class Evidence:
    """One measure of the quality of a mesh.

    Attributes:
        measured: measured value, in `unit`; NaN if nothing was seen.
        unit: "m", "deg", "s" or "" for a plain number.
        action: number of the action, from 0; None for the whole recording.
    """

    name: str
    measured: float
    limit: float
    unit: str
    word: Word
    text: str
    remedy: str
    action: int | None = None


_NO_LENGTH = Evidence(
    "known length", 0.0, 0.0, "", "trust", "neither size nor template confirms the focal length",
    "clothtrack track RECORDING --template FILE",
)  # fmt: skip
"""What trust rests on where nothing in a recording has a known length: the plane of the table and
all that lies on it only grow with the focal length."""

NO_ACTION = "no action, so that no mesh was judged"


@dataclass(frozen=True)
class Verdict:
    """Verdict on a label or a trajectory.

    Attributes:
        word: "trust": use it; "look": look at it first; "reject": do not use it.
        reason: the decisive evidence, in words.
        expected_error_m: expected mean vertex error [m]; NaN if nothing was seen.
        evidence: all evidence, the worst first.
        trusted_up_to_m: largest expected error that is trusted [m].
    """

    word: Word
    reason: str
    expected_error_m: float
    evidence: tuple[Evidence, ...] = ()
    trusted_up_to_m: float = LIMITS["expected error"].look

    __repr__ = short_repr

    def __str__(self) -> str:
        """Return the verdict in one readable line."""
        return f"{self.word}: {self.reason}"

    def _repr_html_(self) -> str:
        rows = {
            f"{number}: {one.name}": f"{one.word}: {one.text}"
            for number, one in enumerate(self.evidence, start=1)
        }
        return html_table(str(self), rows)

    def of_label(self, action: int) -> "Verdict":
        """Return the verdict on one action's label, from evidence on it and on the recording."""
        about = [one for one in self.evidence if one.action in (None, action)]
        known = [one.measured for one in about if one.name == "expected error"]
        return _verdict(about, *known or [math.nan], self.trusted_up_to_m)

    @property
    def remedy(self) -> str:
        """Remedy for the decisive evidence; empty if there is none against the mesh."""
        return "" if self.word == "trust" or not self.evidence else self.evidence[0].remedy

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as plain JSON values; unknown values are None."""
        plain = asdict(self)
        plain["expected_error_m"] = _known(self.expected_error_m)
        for one in plain["evidence"]:
            one["measured"], one["limit"] = _known(one["measured"]), _known(one["limit"])
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> "Verdict":
        """Return the verdict that `as_dict` wrote.

        Raises:
            KeyError, TypeError: the values are not a verdict.
        """
        evidence = tuple(
            Evidence(**one | {name: _or_nan(one[name]) for name in ("measured", "limit")})
            for one in plain["evidence"]
        )
        expected = _or_nan(plain["expected_error_m"])
        limit_m = plain.get("trusted_up_to_m", cls.trusted_up_to_m)  # once it was not stored
        return cls(plain["word"], plain["reason"], expected, evidence, limit_m)


def trajectory_verdict(
    labels: Sequence[LabelQuality],
    findings: Iterable[Finding] = (),
    later: Iterable[tuple[int, Misplaced]] = (),
    rests_on: Sequence[Evidence] = (),
) -> Verdict:
    """Return the verdict on a trajectory from its worst evidence."""
    evidence = [*rests_on, *map(_of_finding, findings)]
    for frame, part in later:
        text = f"{part.text}, by frame {frame}, after an action"
        evidence.append(_measured("left behind", part.share, text))
    for label in labels:
        evidence += evidence_of(label)
    if not labels:
        return Verdict("look", NO_ACTION, math.nan, tuple(evidence))
    expected = [1e-3 * label.expected_error_mm for label in labels]
    return _verdict(
        evidence, max(expected, key=_or_infinite), LIMITS["expected error"].look, len(labels)
    )


def judge(
    tracked: TrackedTrajectory,
    recording: Recording,
    labels: Sequence[LabelQuality] | None = None,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
    frames: ObservedFrames | None = None,
) -> Verdict:
    """Return the verdict on a trajectory from all evidence."""
    if labels is None:
        labels = judge_labels(tracked, recording, segmenter=segmenter, device=device)
    later = left_behind(tracked, recording, segmenter=segmenter, device=device)
    cloth = recording.cloth
    known = cloth.size_m is not None or cloth.template is not None
    findings = check_geometry(recording, frames)
    return trajectory_verdict(labels, findings, later, rests_on=() if known else (_NO_LENGTH,))


def verdict_of(
    tracked: TrackedTrajectory,
    recording: Recording,
    labels: Sequence[LabelQuality] | None = None,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
) -> Verdict:
    """Return the verdict that is stored with a trajectory, or compute one; as for `judge`."""
    if tracked.verdict_fields:
        return Verdict.from_dict(tracked.verdict_fields)
    return judge(tracked, recording, labels, segmenter=segmenter, device=device)


def judged(
    tracked: TrackedTrajectory,
    recording: Recording,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
    frames: ObservedFrames | None = None,
) -> dict[str, Any]:
    """Return the verdict as it is stored with a trajectory (`tracking.pipeline.Judge`)."""
    return judge(tracked, recording, segmenter=segmenter, device=device, frames=frames).as_dict()


def evidence_of(label: LabelQuality) -> list[Evidence]:
    """Return the evidence about one label."""
    expected_m, strain = 1e-3 * label.expected_error_mm, label.evidence.edge_strain_p95
    part, idle = label.misplaced, label.idle_pickers
    found = [
        _measured("expected error", expected_m, f"expected error {1e3 * expected_m:.1f} mm"),
        _measured("stretched edges", strain, f"edges are stretched by {100 * strain:.0f} %"),
        _measured("misplaced part", part.share, part.text),
        _measured(
            "pickers that hold nothing",
            float(len(idle)),
            f"picker {' and '.join(idle)} holds no cloth" if idle else "every picker holds cloth",
        ),
    ]
    return [replace(one, action=label.action) for one in found]


def picture_verdict(
    result: NetworkMesh, agreement: Agreement, given: Collection[str] = ()
) -> Verdict:
    """Return the verdict on the mesh of one picture."""
    mesh, expected_error_m = result.mesh, result.expected_error_m
    assert mesh is not None
    flat = np.asarray(mesh.vertices if mesh.canonical is None else mesh.canonical)
    expected_m = math.nan if expected_error_m is None else expected_error_m
    side_m = float(np.ptp(flat[:, :2], axis=0).max())
    apart, share = 1.0 - agreement.iou, expected_m / side_m
    unsure = 1.0 - result.reconstruction.mean_confidence
    evidence = [
        _measured("silhouette", apart, f"the silhouettes differ by {100 * apart:.0f} %"),
        _measured(
            "visible surface over side",
            agreement.surface_m / side_m,
            f"the visible surface is {1e3 * agreement.surface_m:.0f} mm from the cloud",
        ),
        _measured(
            "expected error over side",
            share,
            f"the network expects an error of {100 * share:.1f} % of the longer side",
        ),
        _measured(
            "unsure correspondences",
            unsure,
            f"the network is unsure of {100 * unsure:.0f} % of its correspondences",
        ),
    ]
    if expected_error_m is None:
        text = "the network does not say how far off it may be"
        evidence[2] = replace(evidence[2], word="look", text=text)
    if (turns := result.spread_over_turns) is not None:
        text = f"answers in other turns of the picture lie {100 * turns:.1f} % of the side away"
        evidence.append(_measured("spread over turns", turns, text))
    helpful = _other_input(given)
    evidence = [replace(one, remedy=one.remedy or helpful) for one in evidence]
    return _verdict(evidence, expected_m, LIMITS["expected error over side"].look * side_m)


def _other_input(given: Collection[str]) -> str:
    """Return the options that tell the network more than what was given."""
    options = [] if "mask" in given else ["the cloth's --mask"]
    if "template" not in given:
        size = "--template instead of its --size" if "size" in given else "--size or --template"
        options.insert(0, f"the garment's {size}")
    return f"give {', or '.join(options)}" if options else _OTHER_PICTURE


def _of_finding(finding: Finding) -> Evidence:
    """Return a finding of the recording's checks as evidence."""
    return Evidence(
        finding.kind, finding.measured, finding.limit, finding.unit,
        "look" if finding.severity == "doubt" else "trust", finding.text,
        "clothtrack inspect RECORDING",
    )  # fmt: skip


def _measured(name: str, measured: float, text: str) -> Evidence:
    limit = LIMITS[name]
    word: Word = "trust"
    if not math.isfinite(measured):
        word, text = "reject", _UNSEEN.get(name, "nothing of the cloth was seen at its end")
    elif measured > limit.reject:
        word = "reject"
    elif measured > limit.look:
        word = "look"
    return Evidence(name, measured, limit.look, limit.unit, word, text, limit.remedy)


def _verdict(
    evidence: Iterable[Evidence], expected_m: float, limit_m: float, actions: int = 1
) -> Verdict:
    """Return the verdict from the worst evidence, with the reason."""
    ranked = sorted(evidence, key=lambda one: (-WORDS.index(one.word), -_excess(one)))
    against = [one for one in ranked if one.word != "trust"]
    text, up_to = f"expected error {1e3 * expected_m:.1f} mm", f"trusted up to {1e3 * limit_m:.0f}"
    if not against:
        text += f" ({up_to})"
        if _NO_LENGTH in ranked:
            text += f"; {_NO_LENGTH.text}"
        return Verdict("trust", text, expected_m, tuple(ranked), limit_m)
    worst = against[0]
    notes = [_bound(worst)]
    if not math.isfinite(expected_m):
        notes.append(f"errors {up_to} mm")
    elif worst.name != "expected error":
        notes.append(f"{text}, {up_to}")
    reason = f"{worst.text} ({'; '.join(filter(None, notes))})"
    if worst.action is not None and actions > 1:
        reason += f", after action {worst.action + 1} of {actions}"
    if len(against) > 1:
        reason += f"; {len(against) - 1} more"
    return Verdict(worst.word, reason, expected_m, tuple(ranked), limit_m)


def _bound(one: Evidence) -> str:
    """Return the limits of the decisive evidence in words."""
    limit = LIMITS.get(one.name)
    if limit is None or not limit.named or not math.isfinite(one.measured):
        return ""
    scale, unit = (1e3, "") if limit.unit == "m" else (100.0, " %")
    words = f"trusted up to {scale * limit.look:g}{unit}"
    if one.word == "reject":
        words += f", rejected above {scale * limit.reject:g}{unit}"
    return words


def _excess(one: Evidence) -> float:
    """Return the measured value relative to the limit."""
    return _or_infinite(one.measured) / one.limit if one.limit > 0 else _or_infinite(one.measured)


def _or_infinite(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
