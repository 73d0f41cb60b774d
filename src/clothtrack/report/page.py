"""One offline page per trajectory: video, scene, curves, actions, settings in a single file.

Everything is inside the file, and a content security policy in it forbids the browser to fetch
anything else, so it can be mailed, archived and opened years later.
"""

import base64
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.report.curves import chart_html
from clothtrack.report.evidence import CloudReader, observed_points
from clothtrack.report.measures import chamfer_rms_mm, charts, edge_strains
from clothtrack.report.overlay import Overlay, OverlayConfig, write_overlay_video
from clothtrack.report.palette import HIDDEN, INSIDE, OUTSIDE, hexadecimal
from clothtrack.report.scene import SceneConfig, scene_html
from clothtrack.report.sections import (
    actions_html,
    figures_of,
    key_figures,
    lead_line,
    settings_html,
)
from clothtrack.storing import whole_file
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' data: blob:; "
    "style-src 'unsafe-inline' data:; img-src data: blob:; media-src data: blob:; "
    "font-src data:; connect-src data: blob:; worker-src data: blob:; frame-src 'self' data: blob:"
)


@dataclass(frozen=True)
class ReportConfig:
    """How much goes into a page.

    Attributes:
        video_frames: at most this many frames in the video, evenly chosen.
        scene_frames: at most this many frames in the scene, evenly chosen.
        scene_vertices: at most this many vertices over all frames of the scene.
        overlay: how the video looks.
        scene: what the scene holds.
    """

    video_frames: int = 360
    scene_frames: int = 180
    scene_vertices: int = 750_000
    overlay: OverlayConfig = field(default_factory=OverlayConfig)
    scene: SceneConfig = field(default_factory=SceneConfig)


def write_report(
    tracked: TrackedTrajectory,
    recording: Recording,
    path: Path,
    *,
    config: ReportConfig | None = None,
    cloud: CloudReader = observed_points,
) -> Path:
    """Write the page of one tracked trajectory and return its path.

    `cloud` gives the observed cloth of a frame; by default the recording's own.

    Raises:
        StorageError: when the disk refuses; what was at `path` before is untouched then.
    """
    config = config or ReportConfig()
    overlay = Overlay(tracked, recording, config=config.overlay, cloud=cloud)
    clouds = [cloud(recording, overlay.frame(step)) for step in range(len(tracked.frames))]
    page = _page(tracked, recording, overlay, clouds, config)
    with whole_file(Path(path)) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Path(path)


def report(
    tracked: Path, recording: Path, path: Path | None = None, *, config: ReportConfig | None = None
) -> Path:
    """Write the page of a stored trajectory and return its path: `tracked`.html by default.

    Raises:
        InvalidResultError: when the trajectory cannot be read.
        InvalidRecordingError: when the recording cannot be read.
        StorageError: when the disk refuses.
    """
    return write_report(
        TrackedTrajectory.load(tracked),
        read_recording(recording),
        path or tracked.parent / f"{tracked.stem}.html",
        config=config,
    )


def _page(
    tracked: TrackedTrajectory,
    recording: Recording,
    overlay: Overlay,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    config: ReportConfig,
) -> str:
    rms_mm = chamfer_rms_mm(tracked, clouds)
    actions = [(action.first_frame, action.last_frame) for action in tracked.actions]
    curves = "".join(
        chart_html(chart, tracked.frames, actions) for chart in charts(tracked, rms_mm)
    )
    figures = figures_of(tracked, rms_mm, edge_strains(tracked))
    wide = " wide" if len(overlay.views) > 1 else ""
    title = escape(tracked.name)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} · clothtrack</title>
<link rel="icon" href="data:,">
<style>{_resource("page.css")}</style>
</head>
<body>
<main>
<h1>{title}</h1>
{lead_line(tracked, recording)}
{key_figures(figures)}
<div class="stage{wide}">
{_video_card(tracked, overlay, config)}
{_scene_card(tracked, recording, clouds, config)}
</div>
<h2>Over time</h2>
<p class="note">Shaded bands are actions. Press on a chart to see that frame in the video.</p>
<div class="charts">{curves}</div>
<h2>Actions</h2>
{actions_html(tracked, recording, device=config.overlay.device)}
{settings_html(tracked, recording)}
</main>
<script>{_resource("page.js")}</script>
</body>
</html>
"""


def _video_card(tracked: TrackedTrajectory, overlay: Overlay, config: ReportConfig) -> str:
    steps = _evenly(len(tracked.frames), config.video_frames)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "overlay.mp4"
        rate = write_overlay_video(overlay, path, steps=steps)
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    frames = [int(tracked.frames[step]) for step in steps]
    return (
        '<section class="card"><header><b>Over the observation</b>'
        f"{_swatch(OUTSIDE, 'visible')}{_swatch(HIDDEN, 'hidden, believed')}</header>"
        f'<video controls loop muted playsinline preload="auto" data-rate="{rate:.6g}" '
        f'data-frames="{frames}" src="data:video/mp4;base64,{data}"></video></section>'
    )


def _scene_card(
    tracked: TrackedTrajectory,
    recording: Recording,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    config: ReportConfig,
) -> str:
    most = max(2, config.scene_vertices // tracked.mesh.vertex_count)
    steps = _evenly(len(tracked.frames), min(config.scene_frames, most))
    document = scene_html(
        tracked, recording, [clouds[step] for step in steps], steps=steps, config=config.scene
    )
    return (
        '<section class="card"><header><b>In space</b>'
        f"{_swatch(OUTSIDE, 'outer side')}{_swatch(INSIDE, 'inner side')}"
        "&ensp;dots: observed; drag to orbit</header>"
        f'<iframe title="Scene in three dimensions" srcdoc="{escape(document, quote=True)}">'
        "</iframe></section>"
    )


def _swatch(color: tuple[float, float, float], words: str) -> str:
    return f'<i class="swatch" style="background:{hexadecimal(color)}"></i>{escape(words)}'


def _evenly(count: int, most: int) -> list[int]:
    """At most `most` of the numbers 0 to count - 1, evenly spaced, both ends included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()


def _resource(name: str) -> str:
    return files("clothtrack.report").joinpath(name).read_text(encoding="utf-8")
