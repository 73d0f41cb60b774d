"""Export of a tracked trajectory as a Rerun recording (.rrd).

Only this module needs the extra [rerun].
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.files.atomic_write import atomic_file
from clothtrack.files.extras import require_extra
from clothtrack.recordings.pictures import read_color
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.report.coloring import Coloring
from clothtrack.report.curves import Chart
from clothtrack.report.palette import (
    HIDDEN,
    OBSERVED,
    OUTSIDE,
    PICKER_CLOSED,
    PICKER_OPEN,
    heat,
    rgb255,
)
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


def write_rerun(
    tracked: TrackedTrajectory,
    recording: Recording,
    path: Path,
    *,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    colorings: Sequence[Coloring] = (),
    charts: Sequence[Chart] = (),
) -> Path:
    """Write mesh, observed points, pickers, color pictures and curves over frame and time.

    The entities are `world/cloth` (colored by visibility), `world/cloth_KEY` per coloring,
    `world/observed`, `world/picker/NAME`, `camera/NAME`, and `curves/...`. The time lines are
    `frame` and `time`.
    """
    require_extra("rerun", ["rerun"], "writing .rrd")
    # Import by name because type checkers find it in some installations only.
    rr = import_module("rerun")
    with atomic_file(path) as temporary:
        stream = rr.RecordingStream("clothtrack", recording_id=tracked.name)
        stream.save(str(temporary))
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        frames = {frame.index: frame for frame in recording.frames}
        for step, index in enumerate(tracked.frames.tolist()):
            time_s = float(tracked.time_s[step])
            stream.set_time("frame", sequence=index)
            stream.set_time("time", duration=time_s)
            _log_cloth(rr, stream, tracked, step, colorings)
            stream.log(
                "world/observed",
                rr.Points3D(clouds[step], colors=rgb255(OBSERVED), radii=0.0012),
            )
            for name, tool in recording.picker_paths.items():
                color = PICKER_CLOSED if tool.closed_at(time_s) else PICKER_OPEN
                tip = rr.Points3D([tool.position_at(time_s)], colors=rgb255(color), radii=0.008)
                stream.log(["world", "picker", name], tip)
            if index in frames:
                _log_pictures(rr, stream, frames[index])
            for chart in charts:
                for line in chart.lines:
                    value = float(line.values[step])
                    if np.isfinite(value):
                        stream.log(_curve(chart, line.label), rr.Scalars(value))
        stream.flush()
        stream.disconnect()
    return path


def _log_cloth(
    rr: Any, stream: Any, tracked: TrackedTrajectory, step: int, colorings: Sequence[Coloring]
) -> None:
    vertices, faces = tracked.positions[step], tracked.mesh.faces.astype(np.uint32)
    corners = vertices[faces]
    normals = np.zeros_like(vertices)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.add.at(normals, faces.ravel(), np.repeat(across, 3, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    paints = {"world/cloth": np.where(tracked.visible[step][:, None], OUTSIDE, HIDDEN)}
    for one in colorings:
        paints[f"world/cloth_{one.key}"] = heat(one.values[step], one.limit)
    for entity, paint in paints.items():
        stream.log(
            entity,
            rr.Mesh3D(
                vertex_positions=vertices,
                triangle_indices=faces,
                vertex_normals=normals,
                vertex_colors=np.rint(255 * paint).astype(np.uint8),
            ),
        )


def _log_pictures(rr: Any, stream: Any, frame: Frame) -> None:
    for name, file in frame.color.items():
        try:
            picture = read_color(file)
        except ClothTrackError:
            continue  # an unreadable picture must not fail the export
        stream.log(["camera", name], rr.Image(picture).compress(jpeg_quality=85))


def _curve(chart: Chart, label: str) -> list[str]:
    """Return the parts of a curve's path as text, which Rerun escapes itself."""
    words = f"{chart.title} [{chart.unit}]" if chart.unit else chart.title
    return ["curves", *(part for part in (words, label) if part)]
