"""A local web page for recording, with preview, instructions and warnings."""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.recordings.recording import Recording
from clothtrack.report.lettering import Picture
from clothtrack.report.local_page import serving, wait_for
from clothtrack.report.palette import PAPER, heat, rgb255
from clothtrack_capture.click_pages import page_of
from clothtrack_capture.live_capture import CapturedFrame, CaptureWriter, DepthCamera

logger = logging.getLogger(__name__)

PROTOCOL = (
    ("flat", "Lay the cloth flat, all of it in the picture. Hands and tool out of the picture."),
    ("pick-and-place 1", "First pick-and-place. Then hands and tool out of the picture."),
    ("pick-and-place 2", "Second pick-and-place. Then hands and tool out of the picture."),
    ("pick-and-place 3", "Third pick-and-place. Then hands and tool out of the picture."),
    ("end", "Done: finish. Then shake the cloth out and lay it flat again for the next one."),
)
"""The paper's protocol: a flat start, three pick-and-places, and the reset between recordings."""

LEAST_MEASURED = 0.6
NEAREST_M, FARTHEST_M = 0.25, 1.6
_PREVIEW_WIDTH = 640
FAREWELL_S = 0.6


class Session:
    """A recording in progress: the camera, the writer, and the step of the protocol."""

    def __init__(self, source: DepthCamera, target: Path, provenance: Mapping[str, Any]) -> None:
        """Prepare a recording; nothing is written before `start`."""
        self._source, self._target, self._provenance = source, target, provenance
        self._writer: CaptureWriter | None = None
        self._latest: CapturedFrame | None = None
        self._arrivals: list[float] = []
        self._lock = threading.Lock()
        self.step = -1
        self.stop = threading.Event()
        self.ended = False
        self.done = False

    def start(self) -> None:
        """Start writing with the first step."""
        with self._lock:
            if self._writer is None:
                self._writer = CaptureWriter(self._target, self._source, self._provenance)
                self.step = 0
                self._writer.mark(PROTOCOL[0][0])

    def advance(self) -> None:
        """Advance to the next step."""
        with self._lock:
            if self._writer is not None and self.step < len(PROTOCOL) - 1:
                self.step += 1
                self._writer.mark(PROTOCOL[self.step][0])

    def watch(self, limit_s: float | None = None) -> None:
        """Take frames until `stop` is set, the camera ends, or the time limit is reached."""
        first: float | None = None
        for frame in self._source.frames():
            now = time.monotonic()
            first = now if first is None else first
            with self._lock:
                self._latest = frame
                self._arrivals = [*self._arrivals[-30:], now]
                if self._writer is not None:
                    self._writer.add(frame)
            if self.stop.is_set() or (limit_s is not None and now - first > limit_s):
                break
        self.ended = True

    def finish(self) -> Recording | None:
        """Close the camera and make the recording; None if it was not started."""
        self._source.close()
        recording = None if self._writer is None else self._writer.finish()
        self.done = True
        return recording

    def facts(self) -> dict[str, Any]:
        """Return the state that the page shows next to the preview."""
        with self._lock:
            state = None if self._writer is None else self._writer.state
            latest, arrivals = self._latest, self._arrivals
        rate = 0.0
        if len(arrivals) > 1:
            rate = (len(arrivals) - 1) / max(arrivals[-1] - arrivals[0], 1e-3)
        return {
            "target": str(self._target),
            "camera": f"{self._source.camera.width} x {self._source.camera.height}",
            "protocol": [{"name": name, "words": words} for name, words in PROTOCOL],
            "step": self.step,
            "written": 0 if state is None else state.written,
            "dropped": 0 if state is None else state.dropped,
            "rate": round(rate, 1),
            "ended": self.ended,
            "done": self.done,
            "warnings": warnings_of(latest, "" if state is None else state.error),
        }

    def preview(self) -> Picture | None:
        """Return color and depth of the latest frame side by side."""
        with self._lock:
            latest = self._latest
        return None if latest is None else preview_of(latest)


def record_live(
    session: Session,
    *,
    opened: Callable[[str], None] | None = None,
) -> Recording | None:
    """Serve the page while the camera runs, until it is finished or Ctrl-C is pressed."""
    watching = threading.Thread(target=session.watch, daemon=True)
    handlers = page_of(
        "recording_page.html", session.facts, {"/preview.jpg": lambda _: session.preview()},
        {
            "/start": lambda _: session.start(),
            "/next": lambda _: session.advance(),
            "/finish": lambda _: session.stop.set(),
        },
    )  # fmt: skip
    try:
        with serving(*handlers) as address:
            logger.info("record at %s", address)
            watching.start()
            try:
                # A user who has read the address may press Ctrl-C before `opened` returns.
                if opened is not None:
                    opened(address)
                wait_for(session.stop)
            except KeyboardInterrupt:
                session.stop.set()
            watching.join(timeout=10.0)
            recording = session.finish()
            # Wait so that the page can still fetch the final state.
            time.sleep(FAREWELL_S)
            return recording
    finally:
        session.stop.set()


def warnings_of(frame: CapturedFrame | None, error: str = "") -> list[str]:
    """Return warnings about a frame, with advice."""
    if error:
        return [f"nothing is written any more: {error}"]
    if frame is None:
        return ["no picture yet"]
    text = []
    measured = frame.depth_m[frame.depth_m > 0]
    share = measured.size / frame.depth_m.size
    if share < LEAST_MEASURED:
        text.append(
            f"depth in {100 * share:.0f} % of the picture only: more light, less shine, or "
            "another distance"
        )
    if measured.size:
        middle = float(np.median(measured))
        if not NEAREST_M < middle < FARTHEST_M:
            text.append(f"the scene is {middle:.2f} m away: 0.5 to 1 m is best")
    if frame.color is None:
        text.append("no color: the cloth can only be told apart by its height")
    return text


def preview_of(frame: CapturedFrame) -> Picture:
    """Return color on the left and depth on the right: red for near, pale for unmeasured."""
    depth = frame.depth_m
    shown = np.full((*depth.shape, 3), rgb255(PAPER), np.uint8)
    seen = depth > 0
    if seen.any():
        shown[seen] = _depth_colors(depth[seen])
    color = np.full_like(shown, 128) if frame.color is None else frame.color
    size = _PREVIEW_WIDTH, round(_PREVIEW_WIDTH * depth.shape[0] / depth.shape[1])
    sides = [cv2.resize(side, size, interpolation=cv2.INTER_AREA) for side in (color, shown)]
    return np.concatenate(sides, axis=1)


def _depth_colors(depth: Float[np.ndarray, " pixels"]) -> np.ndarray:
    low, high = np.percentile(depth, [1, 99])
    table = np.rint(255.0 * heat(np.linspace(1.0, 0.0, 256), 1.0)).astype(np.uint8)
    place = np.clip((depth - low) / max(high - low, 1e-3), 0.0, 1.0)
    return table[(255 * place).astype(np.uint8)]
