"""Make the video of README and docs: the mesh follows the cloth, with its latency.

    python experiments moving_picture

plays the shipped recording through `clothtrack.LiveTracker`, picture by picture, and writes
docs/images/live.webp: what the camera saw, the mesh over it with its occluded parts in violet, the
mesh alone, and how long each picture took on this machine.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from PIL import Image
from shared.figures import say

import clothtrack as ct
from clothtrack.files.atomic_write import atomic_file
from clothtrack.live.playback import pickers_at
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording
from clothtrack.report.overlay import Overlay, OverlayConfig, scene_view
from clothtrack.report.palette import PAPER, caption, rgb255
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

HEIGHT, SIDE_WIDTH = 240, 320
QUALITY = 55
REST_MS = 1500
"""How long the last picture stays."""

MOST_BYTES = 3_000_000


def played(recording: Recording) -> tuple[ct.Run, list[float]]:
    """Return what is tracked live, and the latency of each picture [s]."""
    camera = recording.cameras[0]
    unit_m = recording.depth_units_m[camera.name]
    tracker = ct.LiveTracker(recording.cloth, camera, table=recording.table)
    begins = {action.first_frame for action in recording.actions}
    ends = {action.last_frame for action in recording.actions}
    latencies = []
    for frame in recording.frames:
        depth, color = read_depth(frame.depth[camera.name], unit_m), None
        if camera.name in frame.color:
            color = read_color(frame.color[camera.name])
        if frame.index in ends:
            tracker.end_action()
        if frame.index in begins:
            tracker.begin_action()
        state = tracker.update(
            frame.time_s, depth, color=color, picker=pickers_at(recording, frame)
        )
        latencies.append(state.latency_s)
    return tracker.close(recording), latencies


def pictures(
    tracked: TrackedTrajectory, recording: Recording, latencies_s: Sequence[float]
) -> Iterator[np.ndarray]:
    """Yield the picture of every frame."""
    overlay = Overlay(tracked, recording, config=OverlayConfig(height=HEIGHT, cameras=1))
    view = scene_view(tracked, recording, width=SIDE_WIDTH, height=HEIGHT)
    shading = ShadingConfig(supersampling=2)
    shader = Shader(tracked.mesh.faces, view, table=recording.table, config=shading)
    gap = np.full((HEIGHT, 4, 3), rgb255(PAPER), np.uint8)
    for step, frame in enumerate(tracked.frames):
        panels = [overlay.observation(step), overlay.draw(step)]
        alone = shader.render(tracked.positions[step].astype(np.float64)).image
        row = np.hstack([panels[0], gap, panels[1], gap, alone])
        hidden = 100 * (1.0 - tracked.visible[step].mean())
        left = f"{tracked.time_s[step]:.1f} s   mesh after {1e3 * latencies_s[frame]:.0f} ms"
        words = caption(row.shape[1], left, f"{hidden:.0f} % of the vertices are hidden", height=26)
        yield np.vstack([row, words])


def main() -> None:
    """Draw the video and print its size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recording", type=Path, default=shipped_recording())
    parser.add_argument("--image", type=Path, default=Path("docs/images/live.webp"))
    arguments = parser.parse_args()
    recording = read_recording(arguments.recording)
    run, latencies_s = played(recording)
    shown = [Image.fromarray(each) for each in pictures(run, recording, latencies_s)]
    step_ms = np.diff([frame.time_s for frame in recording.frames], append=np.nan) * 1e3
    durations = [*np.rint(step_ms[:-1]).astype(int).tolist(), REST_MS]
    with atomic_file(arguments.image) as temporary:
        shown[0].save(
            temporary, "WEBP", save_all=True, append_images=shown[1:], duration=durations,
            loop=0, quality=QUALITY, method=6,
        )  # fmt: skip
    size = arguments.image.stat().st_size
    if size > MOST_BYTES:
        raise SystemExit(f"{arguments.image}: {size / 1e6:.1f} MB, at most 3; lower QUALITY")
    served = 1e3 * np.array(latencies_s[1:])
    say(
        f"{arguments.image}: {size / 1e3:.0f} kB; mesh after {np.median(served):.0f} ms in the "
        f"median, {np.percentile(served, 95):.0f} ms for 95 % of {len(served)} pictures\n"
    )


if __name__ == "__main__":
    main()
