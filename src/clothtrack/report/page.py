"""One offline page per trajectory: video, scene, curves, actions, settings in a single file.

The file is self-contained, and its content security policy forbids the browser to fetch anything
else. It can therefore be mailed, archived and opened years later.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.evaluation.label_review import LabelReview
from clothtrack.evaluation.truth import Truth
from clothtrack.evaluation.verdict import verdict_of
from clothtrack.recordings.recording import Recording
from clothtrack.report.coloring import Coloring, colorings, judged_or_none
from clothtrack.report.curves import chart_html
from clothtrack.report.document import write_document
from clothtrack.report.evidence import evidence_of, thinned
from clothtrack.report.film_colors import vertex_colors
from clothtrack.report.overlay import (
    Overlay,
    OverlayConfig,
    scene_view,
    step_words,
    write_overlay_video,
)
from clothtrack.report.palette import HIDDEN, OUTSIDE
from clothtrack.report.scene_data import SCENE_POINTS, SceneContents, recorded_scene
from clothtrack.report.sections import (
    actions_html,
    charts,
    edge_strains,
    evidence_card,
    figures_of,
    key_figures,
    lead_line,
    review_card,
    settings_html,
    verdict_strip,
)
from clothtrack.report.stage import Pictures, scene_card, stage, swatch, video_card
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

_SCENE_FRAMES = 180
"""Largest number of frames in the scene, evenly chosen, so that a browser can open the page."""


@dataclass(frozen=True)
class ReportConfig:
    """Settings of a page.

    Attributes:
        video_frames: largest number of frames in the video, evenly chosen, plus those of labels.
        scene_vertices: largest number of vertices over all frames of the scene.
    """

    video_frames: int = 360
    scene_vertices: int = 750_000
    overlay: OverlayConfig = field(default_factory=OverlayConfig)


def write_report(
    tracked: TrackedTrajectory,
    recording: Recording,
    path: Path,
    *,
    config: ReportConfig | None = None,
    truth: Truth | None = None,
    review: LabelReview | None = None,
) -> Path:
    """Write the page of one tracked trajectory and return its path."""
    config = config or ReportConfig()
    overlay = Overlay(tracked, recording, config=config.overlay)
    evidence = evidence_of(tracked, recording)
    judged = judged_or_none(tracked, recording)
    colors = colorings(tracked, evidence.clouds, judged, truth)
    actions = [(action.first_frame, action.last_frame) for action in tracked.actions]
    upper = stage(
        [
            _video_card(tracked, overlay, config),
            scene_card(_contents(overlay, evidence.clouds, colors, config)),
        ],
        tracked.frames.tolist(),
        tracked.time_s.tolist(),
        wide=len(overlay.views) > 1,
        actions=actions,
    )
    verdict = verdict_of(tracked, recording, judged) if judged else None
    labels = review_card(tracked, review or LabelReview.blank(tracked), verdict)
    drawn = charts(tracked, evidence.rms_mm, evidence.floor_mm)
    body = f"""{lead_line(tracked, recording)}
{verdict_strip(verdict, len(judged)) + evidence_card(verdict) if verdict else ""}
{upper}
{labels}
{key_figures(figures_of(tracked, evidence, edge_strains(tracked)))}
<h2>Over time</h2>
<p class="note">Shaded bands are actions. Press on a chart to see that frame above.</p>
<div class="charts">{"".join(chart_html(one, tracked.frames, actions) for one in drawn)}</div>
<h2>Actions</h2>
{actions_html(tracked, recording)}
{settings_html(tracked, recording)}"""
    return write_document(path, tracked.name, body)


def _video_card(tracked: TrackedTrajectory, overlay: Overlay, config: ReportConfig) -> str:
    steps = evenly(len(tracked.frames), config.video_frames, always=_labeled_steps(tracked))
    rows, width = overlay.stacked(0).shape[:2]
    pictures = Pictures(
        tracked.frames[steps].tolist(),
        lambda path: write_overlay_video(overlay, path, steps=steps, draw=overlay.stacked),
        (width, rows // 2),
        ("Mesh on the picture", "Raw picture"),
        [" · ".join(step_words(tracked, step)[1].split("   ")) for step in steps],
        "How far the visible mesh was from the observed points, from the square root of half the "
        "alignment objective: where the physics predicted it, and after the alignment.",
    )
    legend = swatch(OUTSIDE, "visible") + swatch(HIDDEN, "hidden, believed")
    return video_card("Over the observation", legend, pictures)


def _contents(
    overlay: Overlay,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    colors: Sequence[Coloring],
    config: ReportConfig,
) -> SceneContents:
    tracked, recording = overlay.tracked, overlay.recording
    most = min(_SCENE_FRAMES, max(2, config.scene_vertices // tracked.mesh.vertex_count))
    steps = evenly(len(tracked.frames), most, always=_labeled_steps(tracked))
    cameras = {camera.name for camera in recording.cameras}
    return recorded_scene(
        recording,
        [overlay.frame(step) for step in steps],
        scene_view(tracked, recording, width=800, height=600),
        [thinned(clouds[step], SCENE_POINTS) for step in steps],
        mesh=tracked.mesh,
        positions=tracked.positions[steps],
        visible=tracked.visible[steps],
        colorings=[replace(one, values=one.values[steps]) for one in colors],
        views=[one for one in overlay.views if one.camera.name in cameras],
        film=vertex_colors(tracked, recording),
    )


def _labeled_steps(tracked: TrackedTrajectory) -> list[int]:
    """Return the steps of the labels, which are always shown."""
    ends = [action.last_frame for action in tracked.actions]
    return np.flatnonzero(np.isin(tracked.frames, ends)).tolist()


def evenly(count: int, most: int, always: Sequence[int] = ()) -> list[int]:
    """Return at most `most` of the numbers 0 to count - 1, evenly spaced, both ends included.

    Those of `always` are included too, even if the result then exceeds `most`.
    """
    if count <= most:
        return list(range(count))
    spaced = np.linspace(0, count - 1, max(2, most - len(always))).round().astype(int)
    return np.union1d(spaced, np.asarray(always, int)).tolist()
