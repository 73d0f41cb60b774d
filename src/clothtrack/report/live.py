"""A page on this machine to look through a tracked trajectory and to judge its labels."""

import logging
import threading
from pathlib import Path

import numpy as np
import viser

from clothtrack.errors import InvalidConfigError, StorageError
from clothtrack.evaluation.label_review import LabelReview, Verdict
from clothtrack.evaluation.truth import Truth
from clothtrack.recordings.recording import Recording
from clothtrack.report.coloring import colorings, judged_or_none
from clothtrack.report.evidence import Observer, evidence_of, observed
from clothtrack.report.layers import Layers
from clothtrack.report.live_panel import (
    KEY_HOOK,
    add_calibrations,
    add_curves,
    legend_html,
    review_html,
)
from clothtrack.report.overlay import scene_view
from clothtrack.report.scene import ClothScene, ObservedScene, face_paint, local_server
from clothtrack.report.stage import LARGEST_GAP_M
from clothtrack.report.viewpoint import layers_axis, upward
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

log = logging.getLogger(__name__)

HIGHEST_PORT = 65_535
SIDES, VISIBLE = "outer and inner side", "visible and hidden"


def view_live(
    tracked: TrackedTrajectory,
    recording: Recording,
    port: int | None = None,
    *,
    stop: threading.Event | None = None,
    observer: Observer = observed,
    truth: Truth | None = None,
    review: LabelReview | None = None,
    review_file: Path | None = None,
) -> None:
    """Serve a page on 127.0.0.1 to look at every frame, until `stop` is set or Ctrl-C is pressed.

    The keys left and right go from frame to frame, up and down from label to label; A accepts, R
    rejects the highlighted label, O leaves it open, and the next label is shown; U takes the last
    decision back. Every decision is written to `review_file` at once.

    Args:
        tracked: what the tracker left.
        recording: what it was tracked from.
        port: any free one by default; the address is written to the log.
        stop: ends the serving.
        observer: looks at a frame; by default as the recording says.
        truth: the true meshes; only with them can the cloth be coloured by its error.
        review: decisions so far.
        review_file: where decisions are written; without it nothing can be decided.

    Raises:
        InvalidConfigError: when there is no such port.
        InvalidResultError: the truth is of another garment or another recording.
    """
    require_port(port)
    page = LivePage(tracked, recording, observer=observer, truth=truth)
    with local_server(port) as server:
        page.build(server, review or LabelReview.blank(tracked), review_file)
        wait(stop)


def require_port(port: int | None) -> None:
    """Refuse what is no port.

    Raises:
        InvalidConfigError: when there is no such port.
    """
    if port is not None and not 0 <= port <= HIGHEST_PORT:
        raise InvalidConfigError(
            f"port is {port}; choose one from 1024 to {HIGHEST_PORT}, or leave it out"
        )


def wait(stop: threading.Event | None) -> None:
    """Return when `stop` is set or Ctrl-C is pressed."""
    try:
        (stop or threading.Event()).wait()
    except KeyboardInterrupt:
        return


class LivePage:
    """The controls of the page and what they do. Everything that takes time is done before."""

    def __init__(
        self,
        tracked: TrackedTrajectory,
        recording: Recording,
        *,
        observer: Observer = observed,
        truth: Truth | None = None,
    ) -> None:
        """Read every observation, judge the labels and colour the vertices."""
        self.tracked, self.recording = tracked, recording
        self._evidence = evidence_of(tracked, recording, observer)
        self.clouds = self._evidence.clouds
        self.judged = judged_or_none(tracked, recording)
        found = colorings(tracked, self.clouds, self.judged, truth)
        self.colorings = {one.title: one for one in found}
        self._eye = scene_view(tracked, recording, width=800, height=600)
        self._axis = layers_axis(recording, self._eye)
        self._layers = Layers(tracked.mesh, self._axis)
        self._lock, self._deciding = threading.Lock(), threading.Lock()
        self._chosen: tuple[int, int] | None = None
        self._past: list[tuple[int, Verdict]] = []

    def build(
        self, server: viser.ViserServer, review: LabelReview, review_file: Path | None
    ) -> None:
        """Put scene and controls on a server, and show the first frame."""
        tracked, recording, gui = self.tracked, self.recording, server.gui
        self._server, self._review, self._file = server, review, review_file
        self._observed = ObservedScene(
            server,
            eye=self._eye,
            up=upward(recording, self._eye),
            points=tracked.positions[:: max(1, len(tracked.frames) // 24)].reshape(-1, 3),
            pickers=recording.picker_paths,
            table=recording.table,
        )
        self._cloth = ClothScene(server, tracked.mesh)
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.set_panel_label(f"{tracked.name} · clothtrack")
        gui.main_panel.dock_right()
        self._told = gui.add_html("")
        self._frame = gui.add_slider(
            "Frame", 0, max(1, len(tracked.frames) - 1), 1, initial_value=0
        )
        self._mode = gui.add_dropdown("Colours", (SIDES, VISIBLE, *self.colorings))
        self._legend = gui.add_html("")
        self._opacity = gui.add_slider("Opacity", 0.1, 1.0, 0.05, initial_value=1.0)
        self._gap = gui.add_slider("Layers apart [m]", 0.0, LARGEST_GAP_M, 0.002, initial_value=0.0)
        self._points = gui.add_checkbox("Observed points", initial_value=True)
        for control in (self._frame, self._mode, self._opacity, self._gap, self._points):
            control.on_update(lambda _: self.show())
        self._add_review(gui)
        add_curves(gui, tracked, self._evidence.rms_mm)
        add_calibrations(gui, tracked)
        self._add_keys(gui)
        self.show()

    def show(self) -> None:
        """Bring the scene to what the controls say; the last call wins."""
        with self._lock, self._server.atomic():
            step = self._step()
            vertices = self.tracked.positions[step].astype(np.float64)
            if self._gap.value > 0:
                ranks = self._layers.ranks(vertices)
                vertices += self._gap.value * ranks[:, None] * self._axis
            self._paint(step, vertices)
            points = self.clouds[step] if self._points.value else np.empty((0, 3))
            self._observed.observe(points, float(self.tracked.time_s[step]))
            self._told.content = self._words(step)
            self._tell_review()

    def decide(self, verdict: Verdict) -> None:
        """Write down what was decided about the highlighted label, and go to the next one."""
        with self._deciding:
            action = self._action()
            if action is None:
                return
            former = self._review.labels[action].verdict
            if self._saved_with(action, verdict):
                self._past.append((action, former))
                self._go_to(action + 1)

    def undo(self) -> None:
        """Take the last decision back, and go to its label."""
        with self._deciding:
            if self._past and self._saved_with(*self._past[-1]):
                action, _ = self._past.pop()
                self._go_to(action)

    def step_by(self, way: int) -> None:
        """Go that many frames on."""
        last = len(self.tracked.frames) - 1
        self._frame.value = min(last, max(0, int(self._frame.value) + way))

    def label_by(self, way: int) -> None:
        """Go that many labels on from the highlighted one."""
        with self._deciding:
            action = self._action()
            if action is not None:
                self._go_to(action + way)

    def _go_to(self, action: int) -> None:
        """Highlight the label of an action, the first or last at most, and show its frame."""
        action = min(len(self._review.labels) - 1, max(0, action))
        goal = self._review.labels[action].frame
        step = int(np.abs(self.tracked.frames - goal).argmin())
        self._chosen = step, action
        if step == self._step():
            self.show()
        else:
            self._frame.value = step

    def _saved_with(self, action: int, verdict: Verdict) -> bool:
        if self._file is None:
            return False
        with self._lock:
            decided = self._review.decided(action, verdict)
            try:
                decided.save(self._file)
            except StorageError as error:
                log.warning("not saved: %s", error)
                self._saved.content = f"**Not saved:** {error}"
                return False
            self._review = decided
            self._saved.content = f"Saved in {self._file.name}"
            return True

    def _paint(self, step: int, vertices: np.ndarray) -> None:
        mode, opacity = self._mode.value, float(self._opacity.value)
        faces = self.tracked.mesh.faces
        if mode == SIDES:
            self._cloth.show(vertices, None, group="sides", opacity=opacity)
        elif mode == VISIBLE:
            seen = self.tracked.visible[step][faces].any(axis=1).astype(int)
            self._cloth.show(vertices, seen, group="visible", opacity=opacity)
        else:
            paint = face_paint(faces, self.colorings[mode], step)
            self._cloth.show(vertices, paint, group="graded", opacity=opacity)
        told = legend_html(self.colorings.get(mode), visibility=mode == VISIBLE)
        if self._legend.content != told:
            self._legend.content = told

    def _step(self) -> int:
        # A slider needs two ends: that of one frame has a second place, which shows the same.
        return min(int(self._frame.value), len(self.tracked.frames) - 1)

    def _action(self) -> int | None:
        """Number of the action whose label is highlighted: the shown frame leads to it.

        Where two actions meet, one frame belongs to both: a label that was chosen stays chosen.
        """
        step, chosen = self._step(), self._chosen
        if chosen is not None and chosen[0] == step:
            return chosen[1]
        frame = self.tracked.frames[step]
        begun = [k for k, one in enumerate(self.tracked.actions) if one.first_frame <= frame]
        return begun[-1] if begun else (0 if self.tracked.actions else None)

    def _words(self, step: int) -> str:
        frame, action = int(self.tracked.frames[step]), self._action()
        told = f"<b>frame {frame}</b>, {self.tracked.time_s[step]:.2f} s"
        if action is not None:
            told += f", action {action + 1} of {len(self.tracked.actions)}"
        share = 100 * self.tracked.visible[step].mean()
        return f'<div class="ct told">{told}, {share:.0f} % visible</div>'

    def _add_review(self, gui: viser.GuiApi) -> None:
        self._verdicts = gui.add_html("")
        if self._file is None or not self._review.labels:
            return
        verdicts: dict[str, Verdict] = {
            "Accept": "accepted", "Reject": "rejected", "Leave open": "open",
        }  # fmt: skip
        buttons = gui.add_button_group("Label", tuple(verdicts))
        buttons.on_click(lambda _: self.decide(verdicts[buttons.value]))
        gui.add_button("Undo").on_click(lambda _: self.undo())
        self._saved = gui.add_markdown(f"Decisions go to {self._file.name}")

    def _tell_review(self) -> None:
        told = review_html(self._review, self.judged, self._action())
        if self._verdicts.content != told:
            self._verdicts.content = told

    def _add_keys(self, gui: viser.GuiApi) -> None:
        for label, key, call in (
            ("Next frame", "arrowright", lambda _: self.step_by(1)),
            ("Frame before", "arrowleft", lambda _: self.step_by(-1)),
            ("Next label", "arrowdown", lambda _: self.label_by(1)),
            ("Label before", "arrowup", lambda _: self.label_by(-1)),
            ("Accept the label", "A", lambda _: self.decide("accepted")),
            ("Reject the label", "R", lambda _: self.decide("rejected")),
            ("Leave the label open", "O", lambda _: self.decide("open")),
            ("Undo the last decision", "U", lambda _: self.undo()),
        ):
            gui.add_command(label, hotkey=key).on_trigger(call)
        gui.add_html(KEY_HOOK)
