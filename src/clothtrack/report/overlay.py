"""The tracked mesh drawn over the camera pictures, as a video and as a contact sheet.

The visible surface is shaded and translucent with a bright outline. Hidden parts are drawn through
it as a wire frame in the hidden hue.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.evaluation.metrics import root_mean_square_mm
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.report.evidence import (
    frame_of,
    has_picture,
    observed_points,
    view_picture,
)
from clothtrack.report.palette import (
    HIDDEN,
    INK,
    OUTSIDE,
    PAPER,
    PICKER_CLOSED,
    PICKER_OPEN,
    Picture,
    caption,
    rgb255,
)
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.report.video import frame_rate, write_picture, write_video
from clothtrack.report.viewpoint import view_of
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

SURFACE = 0.38
"""Opacity of the shaded surface, 0..1; low, so that the picture below stays readable."""

_HIDDEN_WIRES = 0.34
"""Opacity of the hidden wire frame, 0..1; low, so that the visible surface keeps its hue."""

_LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)
"""Weights of red, green and blue in a gray value (ITU-R BT.601)."""


@dataclass(frozen=True)
class OverlayConfig:
    """Settings of the overlay.

    Attributes:
        height: height of each camera's picture [pixels].
        closest: smallest share of a camera's picture that is shown if the cloth fills little of it;
            1 always shows all.
        cameras: largest number of cameras, side by side.
        wires: opacity of the visible wire frame, 0..1.
    """

    height: int = 480
    closest: float = 0.55
    cameras: int = 2
    wires: float = 0.30


class Overlay:
    """Renderer of a tracked trajectory over its recording."""

    def __init__(
        self,
        tracked: TrackedTrajectory,
        recording: Recording,
        *,
        config: OverlayConfig | None = None,
    ) -> None:
        """Prepare the views: the recording's cameras, or a virtual one if it has no picture."""
        self.tracked, self.recording = tracked, recording
        self.config = config or OverlayConfig()
        self.views = _views(tracked, recording, self.config)
        self._shaders = [Shader(tracked.mesh.faces, view.camera) for view in self.views]

    def frame(self, step: int) -> Frame:
        """Return the recording's frame that belongs to a step of the trajectory."""
        return frame_of(self.tracked, self.recording, step)

    def observation(self, step: int) -> Picture:
        """Return the observation at a step, all views side by side."""
        return np.hstack(self._observations(step))

    def draw(self, step: int) -> Picture:
        """Return the tracked mesh over the observation at a step, all views side by side."""
        return np.hstack(self._overlays(step, self._observations(step)))

    def stacked(self, step: int) -> Picture:
        """Return `draw` with the observation below it, each padded to even sides."""
        seen = self._observations(step)
        pair = [np.hstack(pictures) for pictures in (self._overlays(step, seen), seen)]
        height, width = pair[0].shape[:2]
        padding = ((0, height % 2), (0, width % 2), (0, 0))
        return np.vstack([np.pad(picture, padding, mode="edge") for picture in pair])

    def annotated(self, step: int) -> Picture:
        """Return `draw` under a caption with frame, time, action, losses and visible share."""
        picture = self.draw(step)
        left, right = step_words(self.tracked, step)
        return np.vstack([caption(picture.shape[1], left, right), picture])

    def _observations(self, step: int) -> list[Picture]:
        frame = self.frame(step)
        needs_cloud = not all(has_picture(frame, view.camera) for view in self.views)
        points = np.empty((0, 3))
        if needs_cloud:
            points = observed_points(self.recording, frame)
        return [
            view.cut(view_picture(self.recording, frame, view.camera, points))
            for view in self.views
        ]

    def _overlays(self, step: int, observations: Sequence[Picture]) -> list[Picture]:
        vertices = self.tracked.positions[step].astype(np.float64)
        visible = self.tracked.visible[step]
        pictures = []
        for view, shader, picture in zip(self.views, self._shaders, observations, strict=True):
            still = shader.render(vertices)
            cloth = view.cut(still.cloth)
            photographed = has_picture(self.frame(step), view.camera)
            image = _toned_down(picture) if photographed else picture.astype(np.float32)
            # Blue over red cloth would give the hue of "hidden". Therefore only the gray values of
            # the photograph are kept under the mesh.
            pixels, covered = image.reshape(-1, 3), np.flatnonzero(cloth)
            gray = (pixels[covered] @ _LUMINANCE)[:, None]
            shaded = view.cut(still.image).reshape(-1, 3)[covered]
            pixels[covered] = gray + SURFACE * (shaded - gray)
            self._draw_wires(image, view, vertices, visible)
            image = np.clip(image, 0, 255).astype(np.uint8)
            _outline(image, cloth)
            for path in self.recording.picker_paths.values():
                time_s = float(self.tracked.time_s[step])
                _picker(image, view, path.position_at(time_s), path.closed_at(time_s))
            pictures.append(image)
        return pictures

    def _draw_wires(
        self,
        image: Float[np.ndarray, "height width 3"],
        view: "View",
        vertices: Float[np.ndarray, "vertices 3"],
        visible: Bool[np.ndarray, " vertices"],
    ) -> None:
        """Draw the edges, the visible ones dark, the hidden ones in the hidden hue."""
        edges = self.tracked.mesh.edges
        pixels, depth = view.project(vertices)
        ends = np.clip(np.nan_to_num(pixels[edges]), -8000, 8000)
        drawable = (depth[edges] > 1e-3).all(axis=1)
        length = np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
        fineness = float(np.clip(length / 9.0, 0.35, 1.0))
        seen = visible[edges].any(axis=1)
        for chosen, color, opacity in (
            (~seen, HIDDEN, _HIDDEN_WIRES),
            (seen, INK, self.config.wires),
        ):
            layer = np.zeros(image.shape[:2], dtype=np.uint8)
            lines = np.rint(ends[chosen & drawable] * 16).astype(np.int32)
            cv2.polylines(layer, list(lines), False, 255, 1, cv2.LINE_AA, 4)
            flat, drawn = image.reshape(-1, 3), np.flatnonzero(layer)
            weight = layer.ravel()[drawn].astype(np.float32)[:, None] * (opacity * fineness / 255)
            under = flat[drawn]
            flat[drawn] = under + weight * (np.asarray(rgb255(color), np.float32) - under)


@dataclass(frozen=True, eq=False)
class View:
    """Enlarged picture of a camera, and its displayed window."""

    camera: Camera
    rows: slice
    columns: slice

    def cut(self, picture: np.ndarray) -> np.ndarray:
        """Return the window of a picture of the camera."""
        return picture[self.rows, self.columns]

    def project(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
        """Return the window pixels and depths [m] of points in the world [m]."""
        pixels, depth = self.camera.project(points)
        return pixels - (self.columns.start, self.rows.start), depth


def whole_view(camera: Camera) -> View:
    """Return the view of a camera's whole picture."""
    return View(camera, slice(0, camera.height), slice(0, camera.width))


def write_overlay_video(
    overlay: Overlay,
    path: Path,
    *,
    steps: Sequence[int] | None = None,
    draw: Callable[[int], Picture] | None = None,
) -> float:
    """Write the overlay as H.264 MP4 and return its frames per second.

    `steps` selects frames of the trajectory (all by default); the video keeps the recording's
    speed. `draw` returns the picture of a step, by default the annotated one.
    """
    chosen = range(len(overlay.tracked.frames)) if steps is None else steps
    rate = frame_rate(overlay.tracked.time_s[np.asarray(chosen, dtype=np.int64)])
    write_video(map(draw or overlay.annotated, chosen), path, frames_per_second=rate)
    return rate


def write_contact_sheet(overlay: Overlay, path: Path, *, rows: int = 6) -> Path:
    """Write a PNG with `rows` frames: observation, overlay and a shaded 3/4 view in each row."""
    count = len(overlay.tracked.frames)
    steps = np.unique(np.linspace(0, count - 1, min(rows, count)).round().astype(int))
    sheet = np.vstack(list(_sheet_rows(overlay, steps.tolist())))
    write_picture(path, sheet)
    return path


def _sheet_rows(overlay: Overlay, steps: Sequence[int]) -> Iterator[Picture]:
    tracked, height = overlay.tracked, 240
    view = scene_view(tracked, overlay.recording, width=320, height=height)
    shader = Shader(
        tracked.mesh.faces,
        view,
        table=overlay.recording.table,
        config=ShadingConfig(supersampling=2),
    )
    gap = np.full((height, 4, 3), rgb255(PAPER), dtype=np.uint8)
    for step in steps:
        seen, drawn = overlay.observation(step), overlay.draw(step)
        width = round(seen.shape[1] * height / seen.shape[0])
        small = [
            cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in (seen, drawn)
        ]
        row = np.hstack(
            [small[0], gap, small[1], gap, shader.render(tracked.positions[step]).image]
        )
        yield np.vstack([row, caption(row.shape[1], *step_words(tracked, step), height=26)])


def scene_view(
    tracked: TrackedTrajectory, recording: Recording, *, width: int, height: int
) -> Camera:
    """Return a 3/4 view that contains the cloth throughout the trajectory."""
    steps = np.unique(np.linspace(0, len(tracked.frames) - 1, 24).round().astype(int))
    points = tracked.positions[steps].reshape(-1, 3).astype(np.float64)
    return view_of(points, recording, width=width, height=height)


def _views(
    tracked: TrackedTrajectory, recording: Recording, config: OverlayConfig
) -> tuple[View, ...]:
    """Return views of the cameras with pictures; a virtual view if there are no pictures."""
    shown = [frame for frame in recording.frames if frame.index in tracked.frames]
    cameras = [c for c in recording.cameras if any(has_picture(frame, c) for frame in shown)]
    if not cameras:
        width = 2 * round(config.height * 2 / 3)
        camera = scene_view(tracked, recording, width=width, height=config.height)
        return (whole_view(camera),)
    return tuple(_close_up(camera, tracked, config) for camera in cameras[: config.cameras])


def _close_up(camera: Camera, tracked: TrackedTrajectory, config: OverlayConfig) -> View:
    """Return the window of the picture's aspect ratio that contains the cloth in all frames."""
    steps = np.unique(np.linspace(0, len(tracked.frames) - 1, 24).round().astype(int))
    pixels, depth = camera.project(tracked.positions[steps].reshape(-1, 3).astype(np.float64))
    size = np.array([camera.width, camera.height])
    pixels = np.clip(pixels[depth > 1e-3], 0, size - 1)
    share, corner = 1.0, np.zeros(2)
    if len(pixels):
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        share = float(np.clip(1.25 * ((high - low) / size).max(), config.closest, 1.0))
        corner = np.clip((low + high) / 2 - share * size / 2, 0, (1 - share) * size)
    scale = config.height / (share * camera.height)
    large = camera.resized(round(camera.width * scale))
    left, top = np.rint(corner * scale).astype(int).tolist()
    height = min(config.height, large.height)
    width = min(round(share * large.width), large.width)
    left, top = min(left, large.width - width), min(top, large.height - height)
    return View(large, slice(top, top + height), slice(left, left + width))


def step_words(tracked: TrackedTrajectory, step: int) -> tuple[str, str]:
    """Return the caption of a step: frame, time and action; losses and visibility."""
    frame, steps = int(tracked.frames[step]), tracked.steps
    left = f"frame {frame}   {tracked.time_s[step]:.2f} s"
    for number, action in enumerate(tracked.actions):
        if action.first_frame <= frame <= action.last_frame:
            left += f"   action {number + 1} of {len(tracked.actions)}"
            break
    right = []
    if frame in tracked.frames_after_last_action:
        right.append(f"after the last action: the mesh of frame {tracked.actions[-1].last_frame}")
    losses = float(steps.loss_before[step]), float(steps.loss_after[step])
    if np.isfinite(losses).all():
        before, after = (root_mean_square_mm(loss) for loss in losses)
        right.append(f"predicted {before:.1f} mm off the cloud, aligned {after:.1f} mm")
    if steps.gave_up[step]:
        right.append("correction dropped")
    right.append(f"{100 * tracked.visible[step].mean():.0f} % visible")
    return left, "   ".join(right)


def _toned_down(picture: Picture) -> Float[np.ndarray, "height width 3"]:
    """Return a paler, slightly lighter copy, so that the drawing stands out."""
    mixed = 0.54 * np.eye(3, dtype=np.float32) + 0.36 * _LUMINANCE
    image = cv2.transform(picture.astype(np.float32), mixed)
    image += 12.0
    return image


def _outline(image: Picture, cloth: Bool[np.ndarray, "height width"]) -> None:
    contours, _ = cv2.findContours(cloth.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(image, contours, -1, rgb255(PAPER), 2, cv2.LINE_AA)
    cv2.drawContours(image, contours, -1, rgb255(OUTSIDE), 1, cv2.LINE_AA)


def _picker(image: Picture, view: View, tip: Float[np.ndarray, " 3"], closed: bool) -> None:
    """Draw a ring at the picker's tip, filled while it holds."""
    pixels, depth = view.project(tip[None])
    if not (depth[0] > 1e-3 and np.abs(pixels[0]).max() < 1e4):
        return
    center = (round(float(pixels[0, 0])), round(float(pixels[0, 1])))
    color = rgb255(PICKER_CLOSED if closed else PICKER_OPEN)
    cv2.circle(image, center, 9, rgb255(PAPER), 4, cv2.LINE_AA)
    cv2.circle(image, center, 9, color, 2, cv2.LINE_AA)
    cv2.circle(image, center, 4 if closed else 2, color, -1, cv2.LINE_AA)
