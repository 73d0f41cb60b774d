"""Pages on a local server, which save decisions about labels and load newer versions."""

import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, get_args
from urllib.parse import quote, unquote

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation.label_review import LabelReview, Verdict
from clothtrack.report.document import document, served_document
from clothtrack.report.local_page import WAKE_S, Answer, serving, wait_for

_WAITING = '<p class="lead">The page is being written; it shows itself when it is ready.</p>'

Write = Callable[[Path], Path]
"""Function that writes a page to the given path and returns that path."""


@dataclass
class Decisions:
    """Decisions about labels, with the file to which each new decision is written."""

    review: LabelReview
    path: Path

    def take(self, action: Any, verdict: Any) -> None:
        """Write one decision to disk, then apply it."""
        if action not in range(len(self.review.labels)) or verdict not in get_args(Verdict):
            raise InvalidConfigError(
                f"action {action!r} is {verdict!r}; there are actions 0 to "
                f"{len(self.review.labels) - 1}, each {', '.join(get_args(Verdict))}"
            )
        review = self.review.decided(action, verdict)
        review.save(self.path)
        self.review = review


class LivePage:
    """Served page with a version number, and the decisions made in it."""

    def __init__(self, name: str, decisions: Decisions | None = None) -> None:
        """Show a placeholder while the page of this name is being written."""
        self._name, self._decisions = name, decisions
        self._page, self._version = document(name, _WAITING, script=False), 0
        self._lock = threading.Lock()

    def show(self, path: Path) -> None:
        """Serve the page in this file from now on; open browsers reload it."""
        self._renew(path.read_text(encoding="utf-8"))

    def say(self, text: str) -> None:
        """Serve a page with this text, such as the reason for a missing report."""
        self._renew(document(self._name, f'<p class="lead">{escape(text)}</p>', script=False))

    def _renew(self, page: str) -> None:
        with self._lock:
            self._page, self._version = page, self._version + 1

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """Answer a request for the page, its version, or the decisions so far."""
        del query
        with self._lock:
            if path == "/":
                return Answer.page(served_document(self._page, self._version))
            if path == "/version":
                return Answer.of({"version": self._version})
            if path == "/review" and self._decisions is not None:
                return Answer.of(self._decisions.review.as_document())
        return None

    def tell(self, path: str, message: Mapping[str, Any]) -> Answer | None:
        """Apply a decision and return all decisions."""
        if path != "/review" or self._decisions is None:
            return None
        with self._lock:
            self._decisions.take(message["action"], message["verdict"])
            return Answer.of(self._decisions.review.as_document())


@contextmanager
def live_page(
    name: str,
    port: int | None = None,
    *,
    decisions: Decisions | None = None,
    opened: Callable[[str], None] | None = None,
) -> Iterator[LivePage]:
    """Serve a page on 127.0.0.1 while the block runs; the block sets its content."""
    page = LivePage(name, decisions)
    with serving(page.ask, page.tell, port) as address:
        if opened is not None:
            opened(address)
        yield page


def serve(
    name: str,
    write: Write,
    port: int | None = None,
    *,
    decisions: Decisions | None = None,
    opened: Callable[[str], None] | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Serve the page that `write` writes until `stop` is set or Ctrl-C is pressed (`live_page`)."""
    try:
        with live_page(name, port, decisions=decisions, opened=opened) as page:
            with tempfile.TemporaryDirectory() as folder:
                page.show(write(Path(folder) / "page.html"))
            wait_for(stop or threading.Event())
    except KeyboardInterrupt:
        return


@dataclass(frozen=True)
class Report:
    """Page that is written when it is first opened, and the decisions about its labels."""

    write: Write
    decisions: Decisions


class _Folder:
    """Request handler for the index at / and the report NAME at /NAME/."""

    def __init__(self, title: str) -> None:
        self.index = LivePage(title)
        self.pages: Mapping[str, LivePage] = {}
        self.asked: SimpleQueue[str] = SimpleQueue()
        self._known: set[str] = set()

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """Answer a request for the index or a report."""
        name, inside, rest = self._split(path)
        if name not in self.pages:
            return self.index.ask(path, query)
        if not inside:
            # Requests of the page are relative to this address.
            return Answer.page(f'<meta http-equiv="refresh" content="0; url=/{quote(name)}/">')
        if name not in self._known:
            self._known.add(name)
            self.asked.put(name)
        return self.pages[name].ask(f"/{rest}", query)

    def tell(self, path: str, message: Mapping[str, Any]) -> Answer | None:
        """Apply a decision about a label of a report."""
        name, inside, rest = self._split(path)
        return self.pages[name].tell(f"/{rest}", message) if inside and name in self.pages else None

    @staticmethod
    def _split(path: str) -> tuple[str, str, str]:
        """Return the report name of a path, a slash if it continues, and the rest.

        The index links a report as the file NAME.html, as on disk.
        """
        name, inside, rest = unquote(path.removeprefix("/")).partition("/")
        return (name if inside else name.removesuffix(".html")), inside, rest


def serve_folder(
    title: str,
    load: Callable[[], tuple[Write, Mapping[str, Report]]],
    port: int | None = None,
    *,
    opened: Callable[[str], None],
) -> None:
    """Serve an index and its reports on 127.0.0.1 until Ctrl-C is pressed."""
    folder = _Folder(title)
    try:
        with (
            serving(folder.ask, folder.tell, port) as address,
            tempfile.TemporaryDirectory() as written,
        ):
            opened(address)
            path = Path(written) / "page.html"
            write_index, reports = load()
            folder.pages = {name: LivePage(name, one.decisions) for name, one in reports.items()}
            folder.index.show(write_index(path))
            while True:
                try:
                    name = folder.asked.get(timeout=WAKE_S)
                except Empty:
                    continue
                try:
                    folder.pages[name].show(reports[name].write(path))
                except ClothTrackError as error:
                    folder.pages[name].say(f"no report: {error}")
    except KeyboardInterrupt:
        return
