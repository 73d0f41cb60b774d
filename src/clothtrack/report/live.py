"""The report's pages on a local server, which saves decisions and shows newer pages at once."""

import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, get_args

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.label_review import LabelReview, Verdict
from clothtrack.report.document import document, served_document
from clothtrack.report.local_page import Answer, serving

WAITING = '<p class="lead">The page is being written; it shows itself when it is ready.</p>'


@dataclass
class Decisions:
    """Decisions about labels, and the file that holds them.

    Attributes:
        review: decisions so far.
        path: where each further decision is written to.
    """

    review: LabelReview
    path: Path

    def take(self, action: Any, verdict: Any) -> None:
        """Write one decision; it counts only when it is on the disk.

        Args:
            action: number of the action, as a page sent it.
            verdict: a `Verdict`, as a page sent it.

        Raises:
            InvalidConfigError: there is no such label, or no such verdict.
            StorageError: the disk refuses; what was decided before stays.
        """
        if action not in range(len(self.review.labels)) or verdict not in get_args(Verdict):
            raise InvalidConfigError(
                f"action {action!r} is {verdict!r}; there are actions 0 to "
                f"{len(self.review.labels) - 1}, each {', '.join(get_args(Verdict))}"
            )
        review = self.review.decided(action, verdict)
        review.save(self.path)
        self.review = review


class LivePage:
    """A page that a server gives, its version, and the decisions that are made in it."""

    def __init__(self, name: str, decisions: Decisions | None = None) -> None:
        """Show that a page of this name is being written."""
        self._name = name
        self._page, self._version = document(name, WAITING, script=False), 0
        self._decisions = decisions
        self._lock = threading.Lock()

    def show(self, path: Path) -> None:
        """Give the page in this file from now on; browsers that show an older one load it."""
        page = path.read_text(encoding="utf-8")
        with self._lock:
            self._page, self._version = page, self._version + 1

    def say(self, text: str) -> None:
        """Give a page that says this, such as why there is no other one."""
        with self._lock:
            lead = f'<p class="lead">{escape(text)}</p>'
            self._page, self._version = document(self._name, lead, script=False), self._version + 1

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """The page, its version, or the decisions so far."""
        del query
        with self._lock:
            if path == "/":
                page = served_document(self._page, self._version)
                return Answer(page.encode(), "text/html; charset=utf-8")
            if path == "/version":
                return Answer.of({"version": self._version})
            if path == "/review" and self._decisions is not None:
                return Answer.of(self._decisions.review.as_document())
        return None

    def tell(self, path: str, message: Mapping[str, Any]) -> Answer | None:
        """Take a decision; all decisions are the answer."""
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
    """Serve a page on 127.0.0.1 while the block runs; the block says what it shows.

    Args:
        name: title of the page until the block shows one.
        port: of the server; any free one by default.
        decisions: about the labels in the page; without it nothing can be decided.
        opened: is told the address before anything else happens.

    Raises:
        InvalidConfigError: there is no such port, or it is taken.
    """
    page = LivePage(name, decisions)
    with serving(page.ask, page.tell, port) as address:
        if opened is not None:
            opened(address)
        yield page


def serve(
    name: str,
    write: Callable[[Path], Path],
    port: int | None = None,
    *,
    decisions: Decisions | None = None,
    opened: Callable[[str], None] | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Serve what `write` writes to a file until `stop` is set or Ctrl-C is pressed.

    Args:
        name: title of the page until it is written.
        write: writes the page to the path that it is given, and returns that path.
        port: of the server; any free one by default.
        decisions: about the labels in the page; without it nothing can be decided.
        opened: is told the address before the page is written.
        stop: ends the serving from outside.

    Raises:
        InvalidConfigError: there is no such port, or it is taken.
    """
    try:
        with live_page(name, port, decisions=decisions, opened=opened) as page:
            with tempfile.TemporaryDirectory() as folder:
                page.show(write(Path(folder) / "page.html"))
            (stop or threading.Event()).wait()
    except KeyboardInterrupt:
        return
