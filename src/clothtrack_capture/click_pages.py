"""Local web pages: requests by path, and the pages on which one clicks on cloth."""

import threading
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from clothtrack.recordings.recording import Recording
from clothtrack.report.local_page import Answer, Ask, Tell, serve_until
from clothtrack_capture.clicked_picking import ClickedAction, ClickedPicking
from clothtrack_capture.cloth_views import Click
from clothtrack_capture.mask_pictures import jpeg, masked_picture, spread
from clothtrack_capture.segmentation_setup import SegmentationSetup

_THUMBNAILS = 24
LARGEST_WIDTH = 1920

Facts = Callable[[], dict[str, Any]]
Show = Callable[[Mapping[str, str]], "np.ndarray | dict[str, Any] | None"]
Deed = Callable[[Mapping[str, Any]], object]


def page_of(
    markup: str, facts: Facts, shows: Mapping[str, Show], deeds: Mapping[str, Deed]
) -> tuple[Ask, Tell]:
    """Return what serves a page of this package: each deed is answered with the new facts."""

    def ask(path: str, query: Mapping[str, str]) -> Answer | None:
        if path == "/":
            html = files("clothtrack_capture").joinpath(markup).read_text(encoding="utf-8")
            return Answer.page(html)
        if path == "/facts.json":
            return Answer.of(facts())
        shown = shows[path](query) if path in shows else None
        if isinstance(shown, np.ndarray):
            return Answer(jpeg(shown), "image/jpeg")
        return None if shown is None else Answer.of(shown)

    def tell(path: str, message: Mapping[str, Any]) -> Answer | None:
        if path not in deeds:
            return None
        deeds[path](message)
        return Answer.of(facts())

    return ask, tell


def _served(
    markup: str,
    facts: Facts,
    shows: Mapping[str, Show],
    deeds: Mapping[str, Deed],
    keep: Callable[[], Recording],
    *,
    stop: threading.Event | None,
    opened: Callable[[str], None] | None,
) -> Recording | None:
    """Serve a page until its result is kept, `stop` is set or Ctrl-C is pressed."""
    ended, kept = stop or threading.Event(), list[Recording]()

    def kept_now(_: Mapping[str, Any]) -> None:
        kept.append(keep())
        # Stop with a delay, so that the page still receives this answer.
        threading.Timer(0.5, ended.set).start()

    handlers = page_of(markup, facts, shows, {**deeds, "/keep": kept_now})
    serve_until(ended, *handlers, opened=opened)
    return kept[-1] if kept else None


def segment_live(
    setup: SegmentationSetup,
    *,
    stop: threading.Event | None = None,
    opened: Callable[[str], None] | None = None,
) -> Recording | None:
    """Serve the page for a click on the cloth, or a box, until the masks are kept."""
    indices = [frame.index for frame in setup.frames]
    facts = {
        "name": setup.recording.name,
        "camera": setup.camera.name,
        "width": setup.camera.width,
        "height": setup.camera.height,
        "frames": indices,
        "thumbnails": spread(indices, _THUMBNAILS),
    }

    def frame(query: Mapping[str, str]) -> np.ndarray:
        index = int(query["index"])
        mask = None if query.get("plain") == "1" else setup.mask(index)
        width = min(max(int(query["width"]), 16), LARGEST_WIDTH)
        return masked_picture(setup.picture(index), mask, width=width)

    def share(query: Mapping[str, str]) -> dict[str, Any]:
        mask = setup.mask(int(query["index"]))
        return {"share": None if mask is None else float(mask.mean())}

    def choose(message: Mapping[str, Any]) -> None:
        if "click" in message:
            column, row = map(int, message["click"])
            setup.choose_click(int(message["frame"]), (column, row))
        else:
            left, top, right, bottom = map(int, message["box"])
            setup.choose_box(int(message["frame"]), (left, top, right, bottom))

    return _served(
        "segmentation_page.html", lambda: facts | {"chosen": setup.chosen},
        {"/frame.jpg": frame, "/share.json": share}, {"/choose": choose}, setup.keep,
        stop=stop, opened=opened,
    )  # fmt: skip


def pick_live(
    picking: ClickedPicking,
    name: str,
    *,
    stop: threading.Event | None = None,
    opened: Callable[[str], None] | None = None,
) -> Recording | None:
    """Serve the page for picks and places of a bare hand until the clicks are saved."""
    views = picking.views

    def facts() -> dict[str, Any]:
        return {
            "name": views.recording.name,
            "camera": views.camera.name,
            "width": views.camera.width,
            "height": views.camera.height,
            "times": picking.times.tolist(),
            "clicks": [[click.frame, click.column, click.row] for click in picking.clicks],
            "actions": [
                {**picking.summary(action), "path": _path(picking, action)}
                for action in picking.actions()
            ],
        }

    def frame(query: Mapping[str, str]) -> np.ndarray:
        index = int(query["index"])
        mask = views.mask(index) if query.get("mask") == "1" else None
        width = min(views.camera.width, LARGEST_WIDTH)
        return masked_picture(views.picture(index), mask, width=width)

    def click(message: Mapping[str, Any]) -> None:
        column, row = map(int, message["click"])
        picking.add(Click(int(message["frame"]), column, row))

    return _served(
        "picking_page.html", facts, {"/frame.jpg": frame},
        {"/click": click, "/undo": lambda _: picking.undo()}, lambda: picking.keep(name),
        stop=stop, opened=opened,
    )  # fmt: skip


def _path(picking: ClickedPicking, action: ClickedAction) -> list[list[float]]:
    """Return the frame, column and row of the hand while it holds the cloth."""
    times, path = picking.times, action.path
    frames = np.flatnonzero((times >= path.start_s - 1e-6) & (times <= path.end_s + 1e-6))
    pixels, _ = picking.views.camera.project(path.positions_at(times[frames]))
    return np.column_stack([frames, pixels.round(1)]).tolist()
