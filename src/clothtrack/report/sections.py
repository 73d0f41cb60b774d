"""The parts of a trajectory's page, as HTML: facts, labels, actions, charts, settings."""

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from html import escape
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.errors import StorageError
from clothtrack.evaluation.label_review import REVIEW_SUFFIX, LabelReview
from clothtrack.evaluation.metrics import root_mean_square_mm
from clothtrack.evaluation.verdict import LIMITS, Evidence, Verdict
from clothtrack.geometry.quality import edge_strain
from clothtrack.recordings.recording import Recording
from clothtrack.report.curves import Chart, Line
from clothtrack.report.evidence import ObservedSteps
from clothtrack.report.overlay import scene_view
from clothtrack.report.palette import Picture, heat, heat_legend
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.tracked_trajectory import Calibration, TrackedAction, TrackedTrajectory


def lead_line(tracked: TrackedTrajectory, recording: Recording) -> str:
    """Return a one-line summary of the trajectory."""
    cameras = len(recording.cameras)
    duration = float(tracked.time_s[-1] - tracked.time_s[0])
    parts = [
        f"{len(tracked.frames)} frames in {duration:.1f} s",
        _count(len(tracked.actions), "action"),
        _count(cameras, "camera") if cameras else "point clouds only",
        recording.cloth.kind if recording.cloth.kind != "other" else "",
        f"{tracked.mesh.vertex_count:,} vertices, {len(tracked.mesh.faces):,} triangles",
        "on a table" if recording.table is not None else "no table",
    ]
    return f'<p class="lead">{escape(" · ".join(part for part in parts if part))}</p>'


class Figure(NamedTuple):
    """Key figure of a page.

    Attributes:
        value: displayed value; a figure with an empty value is left out.
    """

    name: str
    value: str
    unit: str
    help: str


def key_figures(figures: Sequence[Figure]) -> str:
    """Return a row of key figures."""
    items = "".join(
        f'<div title="{escape(one.help, quote=True)}"><dt>{escape(one.name)}</dt>'
        f"<dd>{escape(one.value)} <small>{escape(one.unit)}</small></dd></div>"
        for one in figures
        if one.value
    )
    return f'<dl class="figures">{items}</dl>'


def figures_of(
    tracked: TrackedTrajectory, evidence: ObservedSteps, strains: Float[np.ndarray, " frames"]
) -> list[Figure]:
    """Return the key figures of a trajectory."""
    steps = tracked.steps
    stepped = int((np.asarray(steps.trials) > 0).sum())
    # `steps` cover only the parameters that were kept; `cpu_s` includes those that were tried.
    kept = np.nansum([steps.predict_s, steps.align_s, steps.correct_s])
    cpu = float(tracked.provenance.get("cpu_s", kept))
    floor = _median(evidence.floor_mm)
    return [
        Figure(
            "Distance to cloud, median", _median(evidence.rms_mm),
            f"mm, of which {floor} are noise" if floor else "mm",
            "Root mean square of the distances from visible mesh to observed points and back. A "
            "perfect mesh would have the noise: what two halves of one cloud are apart.",
        ),
        Figure(
            "Edge strain, mean", f"{100 * strains.mean():.2f}", "%",
            "Mean change of the length of an edge. More than a few per cent: the mesh is torn to "
            "the cloud.",
        ),
        Figure(
            "Visible, mean", f"{100 * tracked.visible.mean():.0f}", "% of vertices",
            "What some camera sees. The rest is the tracker's belief.",
        ),
        Figure(
            "Corrections dropped", str(int(np.sum(steps.gave_up))), f"of {stepped}",
            "Frames in which the physics did not take the camera's correction, however short.",
        ),
        Figure(
            "Computing time", f"{cpu / max(1, len(tracked.frames)):.2f}", "s of CPU per frame",
            "With all parameters that were tried.",
        ),
    ]  # fmt: skip


def actions_html(tracked: TrackedTrajectory, recording: Recording) -> str:
    """Return a card per action: mesh around the final alignment, parameters, calibration."""
    if not tracked.actions:
        return "<p class='lead'>The recording has no action.</p>"
    camera = scene_view(tracked, recording, width=480, height=360)
    fine = ShadingConfig(supersampling=2)
    shader = Shader(tracked.mesh.faces, camera, table=recording.table, config=fine)
    return "".join(
        _action_card(number, action, shader) for number, action in enumerate(tracked.actions, 1)
    )


def settings_html(tracked: TrackedTrajectory, recording: Recording) -> str:
    """Return configuration, versions, seed and the recording's provenance, collapsed."""
    blocks = (
        ("Configuration", tracked.config),
        ("Versions, seed, device", tracked.provenance),
        ("Where the recording comes from", recording.provenance),
    )
    parts = "".join(
        f"<div><h3>{escape(title)}</h3><pre>"
        f"{escape(json.dumps(content, indent=2, default=str, ensure_ascii=False))}</pre></div>"
        for title, content in blocks
        if content
    )
    if not parts:
        return ""
    return (
        "<details><summary>Configuration, versions and seed</summary>"
        f'<div class="settings">{parts}</div></details>'
    )


def jpeg_uri(image: Picture, *, quality: int = 86) -> str:
    """Return an RGB picture as a data URI."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise StorageError(f"a picture of {image.shape} could not be encoded as JPEG")
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")


def _action_card(number: int, action: TrackedAction, shader: Shader) -> str:
    before = action.positions_before_final_alignment.astype(np.float64)
    after = action.positions_after_final_alignment.astype(np.float64)
    moved_mm = 1000 * np.linalg.norm(after - before, axis=1)
    limit = max(1.0, float(np.ceil(np.percentile(moved_mm, 99))))
    change = shader.render(after, colors=heat(moved_mm, limit)).image
    heat_legend(change, "mm", limit)
    losses = action.final_alignment_losses
    objective = ""
    if np.isfinite(losses).all():
        off = [root_mean_square_mm(float(loss)) for loss in losses]
        objective = f": {off[0]:.1f} → {off[1]:.1f} mm off the cloud"
    stills = (
        (shader.render(before).image, "Before the final alignment"),
        (shader.render(after).image, f"After the final alignment{objective}"),
        (change, f"How far it moved: median {np.median(moved_mm):.1f} mm, "
         f"largest {moved_mm.max():.1f} mm"),
    )  # fmt: skip
    held = ", ".join(
        f"{name} held {_count(len(vertices), 'vertex', 'vertices')}"
        for name, vertices in action.held_vertices.items()
    )
    return (
        f'<article class="card action"><h3>Action {number}'
        f"<span>frames {action.first_frame} to {action.last_frame}"
        f"{'; ' + escape(held) if held else ''}</span></h3>"
        f"{stills_html(stills)}"
        f'<div class="tuned"><div>{_parameter_table(action.parameters)}</div>'
        f"<div>{_calibration_html(action.calibration)}</div></div></article>"
    )


def stills_html(stills: Iterable[tuple[UInt8[np.ndarray, "_ _ 3"], str]]) -> str:
    """Return RGB pictures with their captions, side by side."""
    pictures = "".join(
        f'<figure><img alt="{escape(words)}" src="{jpeg_uri(image)}">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
        for image, words in stills
    )
    return f'<div class="stills">{pictures}</div>'


def _calibration_html(calibration: Calibration) -> str:
    """Return the score of every candidate as dots, best first, and the five best in a table."""
    scores = np.asarray(calibration.scores, dtype=np.float64)
    fine = np.flatnonzero(np.isfinite(scores))
    if calibration.best < 0 or not len(fine):
        return '<p class="note">Not calibrated for this action.</p>'
    order = fine[np.argsort(scores[fine], kind="stable")]
    values, unit = 1000 * np.sqrt(scores / 2), "mm"
    what = "distance to the clouds of the action, rolled open loop"
    if calibration.judge == "tracking":
        values, unit = 100 * scores, "%"
        what = "gap between the tracked and the observed outline"
    words = (
        f"{_count(len(scores), 'candidate')} by {calibration.method}, "
        f"{calibration.roll_outs:.4g} roll-outs. Each dot is one candidate's {what} [{unit}], "
        "best first; the chosen one is red."
    )
    heads = "".join(map(_parameter_head, calibration.names))
    rows = "".join(
        "<tr>"
        + "".join(f"<td>{value:.4g}</td>" for value in calibration.candidates[k])
        + f"<td>{values[k]:.2f}</td></tr>"
        for k in order[:5]
    )
    return (
        f'<p class="note">{escape(words)}</p>{_dots(values, order, calibration.best)}'
        "<details><summary>The five best</summary><table>"
        f"<thead><tr>{heads}<th>score [{unit}]</th></tr></thead><tbody>{rows}</tbody>"
        "</table></details>"
    )


def _dots(scores: Float[np.ndarray, " candidates"], order: np.ndarray, best: int) -> str:
    width, height, left, foot = 640, 120, 40, 8
    values = scores[order]
    low, high = float(values.min()), float(values.max())
    span = max(high - low, 1e-6)
    places = left + (np.arange(len(order)) + 0.5) / len(order) * (width - left - 8)
    heights = 10 + (1 - (values - low) / span) * (height - foot - 18)
    circles = "".join(
        f'<circle class="{"best" if k == best else "rest"}" cx="{x:.1f}" cy="{y:.1f}" '
        f'r="{4 if k == best else 2.6}"/>'
        for k, x, y in zip(order, places, heights, strict=True)
    )
    labels = "".join(
        f'<line class="grid" x1="{left}" x2="{width}" y1="{y}" y2="{y}"/>'
        f'<text class="tick" x="{left - 6}" y="{y + 3.5}" text-anchor="end">{value:.1f}</text>'
        for value, y in ((high, 10), (low, height - foot - 8))
    )
    return (
        f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="Calibration scores">'
        f"{labels}{circles}</svg>"
    )


def _count(number: int, noun: str, plural: str = "") -> str:
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def _median(values: Float[np.ndarray, " frames"]) -> str:
    """Return the median of the finite values; empty if there are none."""
    finite = values[np.isfinite(values)]
    return f"{np.median(finite):.1f}" if len(finite) else ""


KEYS = (
    "Keys: <kbd>Space</kbd> play, <kbd>←</kbd> <kbd>→</kbd> frame by frame, <kbd>↑</kbd> "
    "<kbd>↓</kbd> label by label, <kbd>a</kbd> accept, <kbd>r</kbd> reject, <kbd>o</kbd> leave "
    "open the highlighted label and go to the next one, <kbd>u</kbd> undo the last decision, "
    "<kbd>v</kbd> mesh or raw picture, <kbd>c</kbd> the camera's own view or free."
)


_EXPECTED_HELP = (
    "The mean distance between a vertex and where it really is, hidden ones included, that is "
    "usual for labels that look like this one. Estimated from what was observed, without the truth."
)


def review_card(tracked: TrackedTrajectory, review: LabelReview, verdict: Verdict | None) -> str:
    """Return the card with buttons for each label and for saving the review."""
    if not review.labels:
        return ""
    rows = []
    for label, action in zip(review.labels, tracked.actions, strict=True):
        text = _quality_cell(verdict.of_label(label.action)) if verdict else "not judged"
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


def verdict_strip(verdict: Verdict, labels: int) -> str:
    """Return the verdicts of all labels in a row; the page's script marks the current one."""
    chips = "".join(
        f'<button type="button" class="chip" data-mark="{action}" data-word="{found.word}" '
        f'title="{_word_help(found)} {_EXPECTED_HELP}">Label {action + 1} <b>{found.word}</b> '
        f'<span>{_error(found)}</span><small class="decided"></small></button>'
        for action, found in ((one, verdict.of_label(one)) for one in range(labels))
    )
    return f'<div class="verdicts">{chips}</div>'


def evidence_card(found: Verdict, of: str = "recording") -> str:
    """Return a verdict, with the evidence against the mesh first."""
    against = [one for one in found.evidence if one.word != "trust"]
    for_it = [one for one in found.evidence if one.word == "trust"]
    remedy = f"<p>What helps: <code>{escape(found.remedy)}</code></p>" if found.remedy else ""
    folded = ""
    if for_it:
        rows = "".join(_evidence_row(one, of) for one in for_it)
        folded = (
            f"<details><summary>{len(for_it)} measures within their limits</summary>"
            f"<table><tbody>{rows}</tbody></table></details>"
        )
    return (
        f'<section id="evidence" class="card"><header><b class="word" data-word="{found.word}">'
        f"{found.word}</b> {escape(found.reason)}</header>"
        f"<table><tbody>{''.join(_evidence_row(one, of) for one in against)}</tbody></table>"
        f"{remedy}{folded}"
        "</section>"
    )


def _evidence_row(one: Evidence, of: str) -> str:
    scale, unit = (1e3, " mm") if one.unit == "m" else (1.0, f" {one.unit}".rstrip())
    where = of if one.action is None else f"label {one.action + 1}"
    return (
        f'<tr><td><b class="word" data-word="{one.word}">{one.word}</b></td><td>{where}</td>'
        f"<td>{escape(one.text)}</td><td>{scale * one.measured:.3g}{unit}, limit "
        f"{scale * one.limit:.3g}{unit}</td></tr>"
    )


def _quality_cell(found: Verdict) -> str:
    """Return the verdict and expected error of a label, with tooltips."""
    return (
        f'<b class="word" data-word="{found.word}" title="{_word_help(found)}">{found.word}</b> '
        f'<span title="{_EXPECTED_HELP}">expected error {_error(found)}</span>'
    )


def _error(found: Verdict) -> str:
    if not np.isfinite(found.expected_error_m):
        return "not seen"
    error, limit = 1e3 * found.expected_error_m, 1e3 * found.trusted_up_to_m
    return f"{error:.1f} mm, trusted up to {limit:.0f}"


def _word_help(found: Verdict) -> str:
    meaning = {
        "trust": f"Expected to be at most {1e3 * found.trusted_up_to_m:.0f} mm off: use it.",
        "look": "Look at it before it is used.",
        "reject": f"Expected to be more than {1e3 * LIMITS['expected error'].reject:g} mm off, or "
        "nothing was seen: leave it out.",
    }[found.word]
    return escape(f"{meaning} Because: {found.reason}.", quote=True)


_MEANINGS: Mapping[str, tuple[str, str]] = {
    "stretch_compliance": ("m/N", "How far an edge gives to a pull; 0: it does not stretch."),
    "bend_compliance": ("m/N", "How far it gives to bending (at 8 mm spacing); larger: limper."),
    "table_friction": ("", "Coulomb coefficient of cloth on table; larger slides less."),
    "particle_friction": ("", "Coulomb coefficient of cloth on cloth; larger slides less."),
    "held_layers": ("layers", "How many layers the picker took; 0: whatever was nearest."),
    "grasp_offset_z_m": ("m", "Where the picker holds the cloth over its tip."),
}
"""Unit and explanation of each of `clothtrack.tracking.theta.PARAMETERS`."""


def _parameter_head(name: str) -> str:
    """Return the name of a parameter with its unit, and its meaning as a tooltip."""
    unit, meaning = _MEANINGS.get(name, ("", ""))
    words = name.removesuffix("_m").replace("_", " ")
    return (
        f'<th title="{escape(meaning, quote=True)}">{escape(words)}'
        f"{f' [{escape(unit)}]' if unit else ''}</th>"
    )


def _parameter_table(parameters: Mapping[str, float]) -> str:
    """Return a table of the used parameters, compared with the tracker's defaults."""
    defaults = {name: float(value) for name, value in asdict(RunConfig().cloth.theta()).items()}
    rows = "".join(
        f'<tr>{_parameter_head(name)}<td title="{escape(_MEANINGS.get(name, ("", ""))[1])}">'
        f'{value:.4g}</td><td class="note">{_compared(value, defaults.get(name))}</td></tr>'
        for name, value in parameters.items()
    )
    if not rows:
        return ""
    return (
        "<table><thead><tr><th>what was used</th><th></th><th>beside the default</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )


def _compared(value: float, default: float | None) -> str:
    if default is None:
        return ""
    if value == default:
        return "the default"
    if not default:
        return "default 0"
    return f"{value / default:.3g} \N{MULTIPLICATION SIGN} the default {default:.4g}"


def edge_strains(tracked: TrackedTrajectory) -> Float[np.ndarray, " frames"]:
    """Return the mean absolute relative change of edge length against the first mesh, per frame."""
    return np.array([edge_strain(tracked.mesh, positions) for positions in tracked.positions])


def charts(
    tracked: TrackedTrajectory,
    rms_mm: Float[np.ndarray, " frames"],
    floor_mm: Float[np.ndarray, " frames"],
) -> tuple[Chart, ...]:
    """Return the charts of a report, the most informative first."""
    steps = tracked.steps
    gave_up = tuple(int(frame) for frame in tracked.frames[np.asarray(steps.gave_up, dtype=bool)])

    def aligned_mm(losses: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
        return 1e3 * np.sqrt(0.5 * np.asarray(losses, np.float64))

    return (
        Chart(
            "Distance to the observed cloud", "mm",
            (Line("root mean square", rms_mm, 0), Line("noise alone", floor_mm, 2)),
            "Visible mesh to observed points and back. Noise: what two halves of the cloud are "
            "apart, the least that a perfect mesh has.",
        ),
        Chart(
            "Edge strain", "%", (Line("mean over all edges", 100 * edge_strains(tracked)),),
            "Says more about hidden errors than the distance does.",
        ),
        Chart(
            "Alignment", "mm",
            (Line("predicted", aligned_mm(steps.loss_before), 1),
             Line("aligned", aligned_mm(steps.loss_after), 0)),
            "How far the mesh is from the cloud as the physics predicts it, and after the camera "
            "has corrected it (root of half the objective of TTO1).",
        ),
        Chart(
            "Visible share of the cloth", "%",
            (Line("vertices that some camera sees", 100 * tracked.visible.mean(axis=1)),),
            "The rest of the mesh is the tracker's belief.",
            least_top=100.0,
        ),
        Chart(
            "Line search", "",
            (Line("roll-outs tried", np.asarray(steps.trials, dtype=np.float64), 0),),
            "1: the physics took the correction whole. More: it had to be shortened so often. 0: "
            "nothing was corrected, as where an action starts.",
            marks=gave_up, marks_label="correction dropped",
        ),
        Chart(
            "Highest speed", "m/s",
            (Line("fastest vertex of the accepted roll-out", steps.highest_speed),),
            "Peaks while nothing moves: the simulation is unstable.",
        ),
        Chart(
            "Computing time", "s of CPU per frame",
            (Line("predict", steps.predict_s, 0), Line("align", steps.align_s, 1),
             Line("correct", steps.correct_s, 2)),
            "With the parameters that were kept; the search for them is not drawn.",
        ),
    )  # fmt: skip
