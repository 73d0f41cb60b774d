"""A local web page for segmentation: one click on the cloth gives every frame its mask."""

import threading
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

from clothtrack.recordings.recording import Recording
from clothtrack.report.local_page import Answer, serve_until
from clothtrack_capture.mask_pictures import jpeg, masked_picture, spread
from clothtrack_capture.segmentation_setup import SegmentationSetup

_THUMBNAILS = 24
LARGEST_WIDTH = 1920


def segment_live(
    setup: SegmentationSetup,
    *,
    stop: threading.Event | None = None,
    opened: Callable[[str], None] | None = None,
) -> Recording | None:
    """Serve the page until the masks are kept, `stop` is set or Ctrl-C is pressed."""
    stop = stop or threading.Event()
    page = _Page(setup, stop)
    serve_until(stop, page.ask, page.tell, opened=opened)
    return page.kept


class _Page:
    """The request handler of the page."""

    def __init__(self, setup: SegmentationSetup, stop: threading.Event) -> None:
        self._setup, self._stop = setup, stop
        self.kept: Recording | None = None

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """Return the page, facts about the recording, or a frame with its mask."""
        if path == "/":
            markup = files("clothtrack_capture").joinpath("segmentation_page.html").read_bytes()
            return Answer(markup, "text/html; charset=utf-8")
        if path == "/recording.json":
            return Answer.of(self._facts())
        if path == "/frame.jpg":
            width = min(max(int(query["width"]), 16), LARGEST_WIDTH)
            index = int(query["index"])
            plain = query.get("plain") == "1"
            mask = None if plain else self._setup.mask(index)
            return Answer(
                jpeg(masked_picture(self._setup.picture(index), mask, width=width)), "image/jpeg"
            )
        if path == "/share.json":
            mask = self._setup.mask(int(query["index"]))
            return Answer.of({"share": None if mask is None else float(mask.mean())})
        return None

    def tell(self, path: str, message: Mapping[str, Any]) -> Answer | None:
        """Handle a click or box to learn from, or a request to keep the masks."""
        if path == "/choose":
            frame = int(message["frame"])
            if "click" in message:
                column, row = map(int, message["click"])
                self._setup.choose_click(frame, (column, row))
            else:
                left, top, right, bottom = map(int, message["box"])
                self._setup.choose_box(frame, (left, top, right, bottom))
            return Answer.of(self._facts())
        if path == "/keep":
            self.kept = self._setup.keep()
            # Stop with a delay, so that the page still receives this answer.
            threading.Timer(0.5, self._stop.set).start()
            masks = sum(self._setup.camera.name in frame.mask for frame in self.kept.frames)
            return Answer.of({"kept": masks})
        return None

    def _facts(self) -> dict[str, Any]:
        setup = self._setup
        indices = [frame.index for frame in setup.frames]
        return {
            "name": setup.recording.name,
            "camera": setup.camera.name,
            "width": setup.camera.width,
            "height": setup.camera.height,
            "frames": indices,
            "thumbnails": spread(indices, _THUMBNAILS),
            "chosen": setup.chosen,
        }
