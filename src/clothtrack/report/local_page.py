"""A small web server on 127.0.0.1 for interactive pages, which answers only its own pages.

Other pages in the same browser cannot reach it. Requests must name this server (against DNS
rebinding) and must not state another site as their origin. Requests that change something must be
sent as JSON (against foreign forms).
"""

import json
import logging
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from clothtrack.errors import ClothTrackError, InvalidConfigError

logger = logging.getLogger(__name__)

HOST = "127.0.0.1"
WAKE_S = 0.5
"""Wake-up period while waiting for Ctrl-C [s]. One of about 400 interrupted pages kept running,
probably because another thread received the signal, which does not wake the waiting one."""

_LONGEST_MESSAGE = 1 << 16
_HIGHEST_PORT = 65_535


@dataclass(frozen=True)
class Answer:
    """Answer to a request: content, MIME type, and HTTP status."""

    body: bytes
    kind: str = "application/json"
    status: int = 200

    @classmethod
    def of(cls, content: object, status: int = 200) -> "Answer":
        """Return an answer with JSON content."""
        return cls(json.dumps(content).encode(), status=status)

    @classmethod
    def page(cls, html: str) -> "Answer":
        """Return an answer with an HTML page."""
        return cls(html.encode(), "text/html; charset=utf-8")


Ask = Callable[[str, Mapping[str, str]], Answer | None]
Tell = Callable[[str, Mapping[str, Any]], Answer | None]


def _refusal(headers: Message, port: int) -> str | None:
    """Return why a request is refused; None unless another web site sent it.

    Browsers name the requesting site in Origin. Requests for pictures and scripts lack it, but then
    newer browsers mark another site in Sec-Fetch-Site. Following a link to the page is allowed.
    """
    hosts, origins = (headers.get_all(name, []) for name in ("Host", "Origin"))
    site, mode = headers.get("Sec-Fetch-Site", "none"), headers.get("Sec-Fetch-Mode")
    # Browsers omit the default port of HTTP.
    ends = (":80", "") if port == 80 else (f":{port}",)
    own = {f"{name}{end}" for name in (HOST, "localhost") for end in ends}
    if (
        len(hosts) == 1
        and own.issuperset(hosts)
        and {f"http://{o}" for o in own}.issuperset(origins)
        and (site in ("none", "same-origin") or mode == "navigate")
    ):
        return None
    return f"this page is for this machine only; open http://{HOST}:{port}/"


@contextmanager
def serving(ask: Ask, tell: Tell, port: int | None = None) -> Iterator[str]:
    """Serve while the block runs, and yield the address."""
    if port is not None and not 0 <= port <= _HIGHEST_PORT:
        raise InvalidConfigError(
            f"port is {port}; choose one from 1024 to {_HIGHEST_PORT}, or leave it out"
        )
    handler = type("Handler", (_Handler,), {"ask": staticmethod(ask), "tell": staticmethod(tell)})
    try:
        server = _Server((HOST, port or 0), handler)
    except OSError as error:
        raise InvalidConfigError(f"port {port}: {error.strerror}; choose another one") from error
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_address[1]}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def serve_until(
    stop: threading.Event,
    ask: Ask,
    tell: Tell,
    port: int | None = None,
    *,
    opened: Callable[[str], None] | None = None,
) -> None:
    """Serve (`serving`) until `stop` is set or Ctrl-C is pressed; `opened` gets the address."""
    with serving(ask, tell, port) as address, suppress(KeyboardInterrupt):
        # The user may see the address and press Ctrl-C before `opened` returns.
        if opened is not None:
            opened(address)
        wait_for(stop)


def wait_for(stop: threading.Event) -> None:
    """Wait until `stop` is set, with regular wake-ups for Ctrl-C."""
    while not stop.wait(WAKE_S):
        pass


class _Server(ThreadingHTTPServer):
    """Server that tolerates dropped connections."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log a connection that was reset; report everything else."""
        error = sys.exception()
        if isinstance(error, ConnectionError):
            logger.debug("%s: %s", client_address, error)
        else:
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """Request handler that calls `ask` and `tell`."""

    ask: Ask
    tell: Tell
    protocol_version = "HTTP/1.1"
    timeout = 30

    def do_GET(self) -> None:
        """Answer GET."""
        url = urlsplit(self.path)
        self._answer(lambda: self.ask(url.path, dict(parse_qsl(url.query))))

    def do_POST(self) -> None:
        """Answer POST."""
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > _LONGEST_MESSAGE:
            self.close_connection = True
            self._send(Answer.of({"error": "the message has no length, or is too long"}, 413))
            return
        body = self.rfile.read(int(length))
        if self.headers.get_content_type() != "application/json":
            self._send(Answer.of({"error": "send JSON"}, 415))
            return
        try:
            message = json.loads(body)
        except ValueError:
            message = None
        if not isinstance(message, dict):
            self._send(Answer.of({"error": "send a JSON object"}, 400))
            return
        self._answer(lambda: self.tell(urlsplit(self.path).path, message))

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Write to the log, not to the terminal."""
        logger.debug(format, *args)

    def _answer(self, find: Callable[[], Answer | None]) -> None:
        refused = _refusal(self.headers, self.connection.getsockname()[1])
        if refused:
            self._send(Answer.of({"error": refused}, 403))
            return
        try:
            answer = find()
        except ClothTrackError as error:
            answer = Answer.of({"error": str(error)}, 422)
        except (KeyError, TypeError, ValueError) as error:
            answer = Answer.of({"error": f"not understood: {error!r}"}, 400)
        except Exception as error:
            # The page must report a defect, too; a broken connection would give no reason.
            logger.exception("no answer to %s", self.path)
            text = f"{type(error).__name__}: {error}; the terminal says more"
            answer = Answer.of({"error": text}, 500)
        self._send(answer or Answer.of({"error": "no such page"}, 404))

    def _send(self, answer: Answer) -> None:
        try:
            self.send_response(answer.status)
            self.send_header("Content-Type", answer.kind)
            self.send_header("Content-Length", str(len(answer.body)))
            self.send_header("Cache-Control", "no-store")
            # Against clickjacking by another site that embeds the page in a frame.
            self.send_header("X-Frame-Options", "DENY")
            self.end_headers()
            self.wfile.write(answer.body)
        except (BrokenPipeError, ConnectionResetError):
            # The page was closed before the answer was sent.
            self.close_connection = True
