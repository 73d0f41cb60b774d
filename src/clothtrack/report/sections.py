"""The parts of the page, each a piece of HTML: facts, actions with their calibration, settings."""

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.errors import StorageError
from clothtrack.evaluation.metrics import root_mean_square_mm
from clothtrack.recordings.recording import Recording
from clothtrack.report.evidence import Evidence
from clothtrack.report.lettering import heat_legend
from clothtrack.report.overlay import scene_view
from clothtrack.report.palette import heat
from clothtrack.report.parameter_table import parameter_head, parameter_table
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.tracking.tracked_trajectory import Calibration, TrackedAction, TrackedTrajectory


def lead_line(tracked: TrackedTrajectory, recording: Recording) -> str:
    """What was recorded, in one line."""
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
    """A number that a reader wants first.

    Attributes:
        name: what it is.
        value: as it is shown; a figure without one is left out.
        unit: of the value.
        help: what it tells, shown to those who point at it.
    """

    name: str
    value: str
    unit: str
    help: str


def key_figures(figures: Sequence[Figure]) -> str:
    """A row of figures."""
    items = "".join(
        f'<div title="{escape(one.help, quote=True)}"><dt>{escape(one.name)}</dt>'
        f"<dd>{escape(one.value)} <small>{escape(one.unit)}</small></dd></div>"
        for one in figures
        if one.value
    )
    return f'<dl class="figures">{items}</dl>'


def figures_of(
    tracked: TrackedTrajectory, evidence: Evidence, strains: Float[np.ndarray, " frames"]
) -> list[Figure]:
    """The numbers that a reader wants first."""
    steps = tracked.steps
    stepped = int((np.asarray(steps.trials) > 0).sum())
    # The steps are of the parameters that were kept; the whole holds those that were tried too.
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


def actions_html(tracked: TrackedTrajectory, recording: Recording, *, device: str = "cpu") -> str:
    """One card per action: the mesh around the final alignment, parameters, calibration scores."""
    if not tracked.actions:
        return "<p class='lead'>The recording has no action.</p>"
    camera = scene_view(tracked, recording, width=480, height=360)
    shader = Shader(
        tracked.mesh.faces,
        camera,
        table=recording.table,
        config=ShadingConfig(supersampling=2),
        device=device,
    )
    return "".join(
        _action_card(number, action, shader) for number, action in enumerate(tracked.actions, 1)
    )


def settings_html(tracked: TrackedTrajectory, recording: Recording) -> str:
    """Configuration, versions, seed and the recording's own provenance, folded away."""
    blocks = (
        ("Configuration", tracked.config),
        ("Versions, seed, device", tracked.provenance),
        ("Where the recording comes from", recording.provenance),
    )
    parts = "".join(
        f"<div><h3>{escape(title)}</h3><pre>{escape(_pretty(content))}</pre></div>"
        for title, content in blocks
        if content
    )
    if not parts:
        return ""
    return (
        "<details><summary>Configuration, versions and seed</summary>"
        f'<div class="settings">{parts}</div></details>'
    )


def jpeg_uri(image: UInt8[np.ndarray, "height width 3"], *, quality: int = 86) -> str:
    """An RGB picture as a data address.

    Raises:
        StorageError: when the picture cannot be encoded.
    """
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
    pictures = "".join(
        f'<figure><img alt="{escape(words)}" src="{jpeg_uri(image)}">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
        for image, words in stills
    )
    held = ", ".join(
        f"{name} held {_count(len(vertices), 'vertex', 'vertices')}"
        for name, vertices in action.held_vertices.items()
    )
    return (
        f'<article class="card action"><h3>Action {number}'
        f"<span>frames {action.first_frame} to {action.last_frame}"
        f"{'; ' + escape(held) if held else ''}</span></h3>"
        f'<div class="stills">{pictures}</div>'
        f'<div class="tuned"><div>{parameter_table(action.parameters)}</div>'
        f"<div>{calibration_html(action.calibration)}</div></div></article>"
    )


def calibration_html(calibration: Calibration) -> str:
    """The score of every candidate as dots, best first, and the five best in a table."""
    scores = np.asarray(calibration.scores, dtype=np.float64)
    fine = np.flatnonzero(np.isfinite(scores))
    if calibration.best < 0 or not len(fine):
        return '<p class="note">Not calibrated for this action.</p>'
    order = fine[np.argsort(scores[fine], kind="stable")]
    values, what, unit = _readable(calibration.judge, scores)
    words = (
        f"{_count(len(scores), 'candidate')} by {calibration.method}, "
        f"{calibration.roll_outs:.4g} roll-outs. Each dot is one candidate's {what} [{unit}], "
        "best first; the chosen one is red."
    )
    heads = "".join(map(parameter_head, calibration.names))
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


def _readable(
    judge: str, scores: Float[np.ndarray, " candidates"]
) -> tuple[Float[np.ndarray, " candidates"], str, str]:
    """Scores as one reads them, what they are, and their unit."""
    if judge == "tracking":
        return 100 * scores, "gap between the tracked and the observed outline", "%"
    return (
        1000 * np.sqrt(scores / 2),
        "distance to the clouds of the action, rolled open loop",
        "mm",
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


def _pretty(content: Mapping[str, Any]) -> str:
    return json.dumps(content, indent=2, default=str, ensure_ascii=False)


def _count(number: int, noun: str, plural: str = "") -> str:
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def _median(values: Float[np.ndarray, " frames"]) -> str:
    """Of the finite ones; empty where there are none."""
    finite = values[np.isfinite(values)]
    return f"{np.median(finite):.1f}" if len(finite) else ""
