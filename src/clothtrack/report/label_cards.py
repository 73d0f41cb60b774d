"""What a page says about labels: the verdict of each at the top, and a person's decisions."""

import json
from collections.abc import Sequence
from html import escape

import numpy as np

from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.evaluation.label_review import REVIEW_SUFFIX, LabelReview
from clothtrack.evaluation.verdict import LIMITS, Evidence, Verdict, verdict
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

KEYS = (
    "Keys: <kbd>Space</kbd> play, <kbd>←</kbd> <kbd>→</kbd> frame by frame, <kbd>↑</kbd> "
    "<kbd>↓</kbd> label by label, <kbd>a</kbd> accept, <kbd>r</kbd> reject, <kbd>o</kbd> leave "
    "open the highlighted label and go to the next one, <kbd>u</kbd> undo the last decision, "
    "<kbd>v</kbd> mesh or raw picture, <kbd>c</kbd> the camera's own view or free."
)


EXPECTED_HELP = (
    "The mean distance between a vertex and where it really is, hidden ones included, that is "
    "usual for labels that look like this one. Estimated from what was observed, without the truth."
)
QUALITY_HELP = (
    "The weight of this label in training, 0 to 1; one half is typical of the benchmark's labels."
)


def review_card(
    tracked: TrackedTrajectory, review: LabelReview, judged: Sequence[LabelQuality]
) -> str:
    """Accept and reject for each label, and the file to put beside the trajectory."""
    if not review.labels:
        return ""
    rows = []
    for label, action in zip(review.labels, tracked.actions, strict=True):
        text = quality_cell(judged[label.action]) if judged else "not judged"
        rows.append(
            f'<tr data-action="{label.action}" data-first="{action.first_frame}">'
            f'<th><button type="button" class="jump">Label {label.action + 1}</button></th>'
            f'<td><a href="#frame={label.frame}" title="A link to this frame">frame '
            f"{label.frame}</a></td><td>{text}</td>"
            '<td class="verdict"></td><td>'
            '<button type="button" data-decide="accepted">Accept</button> '
            '<button type="button" data-decide="rejected">Reject</button> '
            '<button type="button" data-decide="open">Open</button></td></tr>'
        )
    document = escape(json.dumps(review.as_document()), quote=True)
    name = escape(tracked.name + REVIEW_SUFFIX, quote=True)
    return (
        f'<section id="review" class="card" data-review="{document}" data-file="{name}">'
        "<header><b>Labels</b> the mesh at the end of each action; "
        '<span class="left"></span></header>'
        f"<table><tbody>{''.join(rows)}</tbody></table>"
        f'<p class="note"><button type="button" id="undo">Undo</button> {KEYS}</p>'
        '<p class="note" data-when="served"><output id="saved"></output></p>'
        '<p class="note" data-when="opened"><button type="button" id="save">Save the '
        f"review</button> as {name}; put it beside {escape(tracked.name)}.zarr, and "
        "<code>clothtrack label</code> leaves out what is rejected.</p></section>"
    )


def verdict_strip(judged: Sequence[LabelQuality]) -> str:
    """The verdict of every label, in a row; the page's script marks the one that is shown."""
    if not judged:
        return ""
    chips = "".join(
        f'<button type="button" class="chip" data-mark="{label.action}" '
        f'data-word="{verdict(label).word}" title="{_chip_help(label)}">'
        f"Label {label.action + 1} <b>{verdict(label).word}</b> <span>{_error(label)}</span>"
        '<small class="decided"></small></button>'
        for label in judged
    )
    return f'<div class="verdicts">{chips}</div>'


def evidence_card(found: Verdict) -> str:
    """Return the verdict of the whole trajectory, with the measures that speak against it first."""
    against = [one for one in found.evidence if one.word != "trust"]
    for_it = [one for one in found.evidence if one.word == "trust"]
    remedy = f"<p>What helps: <code>{escape(found.remedy)}</code></p>" if found.remedy else ""
    folded = ""
    if for_it:
        rows = "".join(map(_evidence_row, for_it))
        folded = (
            f"<details><summary>{len(for_it)} measures within their limits</summary>"
            f"<table><tbody>{rows}</tbody></table></details>"
        )
    return (
        f'<section id="evidence" class="card"><header><b class="word" data-word="{found.word}">'
        f"{found.word}</b> {escape(found.reason)}</header>"
        f"<table><tbody>{''.join(map(_evidence_row, against))}</tbody></table>{remedy}{folded}"
        "</section>"
    )


def _evidence_row(one: Evidence) -> str:
    scale, unit = (1e3, " mm") if one.unit == "m" else (1.0, f" {one.unit}".rstrip())
    where = "recording" if one.action is None else f"label {one.action + 1}"
    return (
        f'<tr><td><b class="word" data-word="{one.word}">{one.word}</b></td><td>{where}</td>'
        f"<td>{escape(one.text)}</td><td>{scale * one.measured:.3g}{unit}, limit "
        f"{scale * one.limit:.3g}{unit}</td></tr>"
    )


def quality_cell(judged: LabelQuality) -> str:
    """What is expected of a label, without the truth, with the explanation of each number."""
    if not np.isfinite(judged.expected_error_mm):
        return "nothing was seen to judge it by"
    found = verdict(judged)
    return (
        f'<b class="word" data-word="{found.word}" title="{_word_help(found)}">{found.word}</b> '
        f'<span title="{EXPECTED_HELP}">expected error {_error(judged)}</span>, '
        f'<span title="{QUALITY_HELP}">quality {judged.label_quality:.2f}</span>'
    )


def _error(judged: LabelQuality) -> str:
    error = judged.expected_error_mm
    return f"{error:.1f} mm" if np.isfinite(error) else "not seen"


def _word_help(found: Verdict) -> str:
    error = LIMITS["expected error"]
    meaning = {
        "trust": f"Expected to be at most {1e3 * error.look:g} mm off: use it.",
        "look": "Look at it before it is used.",
        "reject": f"Expected to be more than {1e3 * error.reject:g} mm off, or nothing was seen: "
        "leave it out.",
    }[found.word]
    return escape(f"{meaning} Because: {found.reason}.", quote=True)


def _chip_help(judged: LabelQuality) -> str:
    return f"{_word_help(verdict(judged))} {EXPECTED_HELP}"
