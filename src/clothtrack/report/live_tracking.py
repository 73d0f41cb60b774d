"""The page of `track --live`: the newest mesh over the points that it is aligned to."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.report.document import document, served_document
from clothtrack.report.evidence import observed_points, thinned
from clothtrack.report.local_page import Answer, serving
from clothtrack.report.overlay import whole_view
from clothtrack.report.scene_data import SCENE_POINTS, SceneContents, packed, recorded_scene
from clothtrack.report.stage import scene_card, stage
from clothtrack.report.viewpoint import view_of

_TITLE = "Tracking"

_LAST_WORDS_S = 3.0
"""Longest wait for an open page to show how the tracking ended [s]."""


@dataclass(frozen=True, eq=False)
class _Shown:
    """A mesh with its recording and frame."""

    recording: Recording
    mesh: ClothMesh
    frame: Frame
    positions: Float[np.ndarray, "vertices 3"]

    def contents(self) -> SceneContents:
        """Return the scene of this one mesh."""
        recording, frame = self.recording, self.frame
        return recorded_scene(
            recording,
            [frame],
            view_of(self.positions.astype(np.float64), recording, width=800, height=600),
            [thinned(observed_points(recording, frame), SCENE_POINTS)],
            mesh=self.mesh,
            positions=self.positions[None],
            views=[whole_view(camera) for camera in recording.cameras],
        )


class LiveTracking:
    """Holder of the newest mesh, which is packed only on request so that tracking never waits."""

    def __init__(self, words: Callable[[], str]) -> None:
        """Begin without a mesh; `words` returns the progress of the tracking."""
        self._words, self._newest = words, None
        self._known, self._version, self._asked_s = 0, 0, float("-inf")
        self._end = ""
        self._told = threading.Event()
        self._lock = threading.Lock()

    def watch(
        self,
        recording: Recording,
        mesh: ClothMesh,
        frame: Frame,
        positions: Float[np.ndarray, "vertices 3"],
    ) -> None:
        """Store the newest mesh (`clothtrack.tracking.protocols.Watch`)."""
        with self._lock:
            if self._newest is None or mesh is not self._newest.mesh:
                # A new cloth needs a new page.
                self._version += 1
            self._newest = _Shown(recording, mesh, frame, np.array(positions, np.float32))
            self._known += 1

    def end(self, words: str) -> None:
        """Set the final message, and wait a moment until an open page has it."""
        with self._lock:
            self._end, open_page = words, time.monotonic() - self._asked_s < _LAST_WORDS_S
        if open_page:
            self._told.wait(_LAST_WORDS_S)

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """Return the page, its version, or the newest mesh."""
        with self._lock:
            newest, known, version = self._newest, self._known, self._version
        if path == "/":
            return Answer.page(self._page(newest, version))
        if path == "/version":
            return Answer.of({"version": version})
        if path == "/now":
            return Answer.of(self._now(newest, known, int(query["after"])))
        return None

    def _page(self, newest: _Shown | None, version: int) -> str:
        lead = f'<p class="lead growing">{escape(self._end or self._words())}</p>'
        if newest is None:
            return served_document(document(_TITLE, lead, script=False), version)
        scene = stage([scene_card(newest.contents())], [newest.frame.index], [0.0], wide=True)
        return served_document(document(newest.recording.name, lead + scene), version)

    def _now(self, newest: _Shown | None, known: int, after: int) -> dict[str, Any]:
        """Return the progress, and the newest mesh unless `after` is its number or -1."""
        with self._lock:
            self._asked_s, end = time.monotonic(), self._end
        answer: dict[str, Any] = {"words": end or self._words(), "over": bool(end), "known": known}
        if newest is not None and after not in (-1, known):
            header, data = packed(newest.contents())
            answer |= {"header": header, "data": data, "frame": newest.frame.index}
        elif end:
            self._told.set()
        return answer


@contextmanager
def live_tracking(
    words: Callable[[], str], port: int | None = None, *, opened: Callable[[str], None]
) -> Iterator[LiveTracking]:
    """Serve the page of a tracking on 127.0.0.1 while the block runs (`serving`)."""
    page = LiveTracking(words)
    with serving(page.ask, lambda *_: None, port) as address:
        opened(address)
        yield page
