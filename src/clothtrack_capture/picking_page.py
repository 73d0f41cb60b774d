"""A local web page for clicking where a bare hand picked and placed the cloth."""

import threading
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from clothtrack.recordings.recording import Recording
from clothtrack.report.local_page import Answer, serve_until
from clothtrack_capture.clicked_picking import ClickedAction, ClickedPicking
from clothtrack_capture.cloth_views import Click
from clothtrack_capture.mask_pictures import jpeg, masked_picture

LARGEST_WIDTH = 1920


def pick_live(
    picking: ClickedPicking,
    name: str,
    *,
    stop: threading.Event | None = None,
    opened: Callable[[str], None] | None = None,
) -> Recording | None:
    """Serve the page until the clicks are saved, `stop` is set or Ctrl-C is pressed."""
    stop = stop or threading.Event()
    page = _Page(picking, name, stop)
    serve_until(stop, page.ask, page.tell, opened=opened)
    return page.kept


class _Page:
    """The request handler of the page."""

    def __init__(self, picking: ClickedPicking, name: str, stop: threading.Event) -> None:
        self._picking, self._name, self._stop = picking, name, stop
        self.kept: Recording | None = None

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """Return the page, the clicks so far, or a frame with its mask if requested."""
        if path == "/":
            markup = files("clothtrack_capture").joinpath("picking_page.html").read_bytes()
            return Answer(markup, "text/html; charset=utf-8")
        if path == "/clicks.json":
            return Answer.of(self._facts())
        if path == "/frame.jpg":
            index, views = int(query["index"]), self._picking.views
            picture = views.picture(index)
            mask = views.mask(index) if query.get("mask") == "1" else None
            width = min(views.camera.width, LARGEST_WIDTH)
            return Answer(jpeg(masked_picture(picture, mask, width=width)), "image/jpeg")
        return None

    def tell(self, path: str, message: Mapping[str, Any]) -> Answer | None:
        """Handle a click, an undo or a save."""
        if path == "/click":
            column, row = map(int, message["click"])
            self._picking.add(Click(int(message["frame"]), column, row))
            return Answer.of(self._facts())
        if path == "/undo":
            self._picking.undo()
            return Answer.of(self._facts())
        if path == "/save":
            self.kept = self._picking.keep(self._name)
            # Stop with a delay, so that the page still receives this answer.
            threading.Timer(0.5, self._stop.set).start()
            return Answer.of({"saved": len(self.kept.actions)})
        return None

    def _facts(self) -> dict[str, Any]:
        picking = self._picking
        camera, recording = picking.views.camera, picking.views.recording
        return {
            "name": recording.name,
            "camera": camera.name,
            "width": camera.width,
            "height": camera.height,
            "times": picking.times.tolist(),
            "clicks": [[click.frame, click.column, click.row] for click in picking.clicks],
            "actions": [
                {**picking.summary(action), "path": self._path(action)}
                for action in picking.actions()
            ],
        }

    def _path(self, action: ClickedAction) -> list[list[float]]:
        """Return the frame, column and row of the hand while it holds the cloth."""
        times, path = self._picking.times, action.path
        frames = np.flatnonzero((times >= path.start_s - 1e-6) & (times <= path.end_s + 1e-6))
        pixels, _ = self._picking.views.camera.project(path.positions_at(times[frames]))
        return np.column_stack([frames, pixels.round(1)]).tolist()
