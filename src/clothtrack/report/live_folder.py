"""The reports of a folder of trajectories on one local server, under an index."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any
from urllib.parse import quote, unquote

from clothtrack.errors import ClothTrackError
from clothtrack.report.live import Decisions, LivePage
from clothtrack.report.local_page import Answer, serving


@dataclass(frozen=True)
class Report:
    """A page that is written when somebody looks at it.

    Attributes:
        write: writes it to the path that it is given, and returns that path.
        decisions: about the labels in it.
    """

    write: Callable[[Path], Path]
    decisions: Decisions


class _Folder:
    """Answers for the index at / and for the report NAME at /NAME/."""

    def __init__(self, title: str) -> None:
        self.index = LivePage(title)
        self.pages: Mapping[str, LivePage] = {}
        self.asked: SimpleQueue[str] = SimpleQueue()
        self._known: set[str] = set()

    def ask(self, path: str, query: Mapping[str, str]) -> Answer | None:
        """The index, a report, or what one of them asks."""
        name, inside, rest = self._split(path)
        if name not in self.pages:
            return self.index.ask(path, query)
        if not inside:
            # What the page asks for lies below it.
            text = f'<meta http-equiv="refresh" content="0; url=/{quote(name)}/">'
            return Answer(text.encode(), "text/html; charset=utf-8")
        if name not in self._known:
            self._known.add(name)
            self.asked.put(name)
        return self.pages[name].ask(f"/{rest}", query)

    def tell(self, path: str, message: Mapping[str, Any]) -> Answer | None:
        """Take a decision about a label of a report."""
        name, inside, rest = self._split(path)
        return self.pages[name].tell(f"/{rest}", message) if inside and name in self.pages else None

    @staticmethod
    def _split(path: str) -> tuple[str, str, str]:
        """The report that a path is in, a slash if it goes on, and what follows.

        The index links a report as the file NAME.html, as it does on a disk.
        """
        name, inside, rest = unquote(path.removeprefix("/")).partition("/")
        return (name if inside else name.removesuffix(".html")), inside, rest


def serve_folder(
    title: str,
    load: Callable[[], tuple[Callable[[Path], Path], Mapping[str, Report]]],
    port: int | None = None,
    *,
    opened: Callable[[str], None],
) -> None:
    """Serve an index and its reports on 127.0.0.1 until Ctrl-C is pressed.

    Args:
        title: of the index until it is written.
        load: gives what writes the index, with links to NAME.html, and the reports by name.
        port: of the server; any free one by default.
        opened: is told the address before anything is loaded.

    Raises:
        InvalidConfigError: there is no such port, or it is taken.
    """
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
                name = folder.asked.get()
                try:
                    folder.pages[name].show(reports[name].write(path))
                except ClothTrackError as error:
                    folder.pages[name].say(f"no report: {error}")
    except KeyboardInterrupt:
        return
