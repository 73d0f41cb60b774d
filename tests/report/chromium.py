"""A headless browser without network, driven through the DevTools protocol."""

import base64
import contextlib
import itertools
import json
import re
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from websockets.sync.client import ClientConnection, connect

SWITCHES = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-quic", "--no-first-run", "--remote-debugging-port=0", "--window-size=1366,900",
)  # fmt: skip


def find_chromium() -> str | None:
    """The browser's program, if this machine has one."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next(filter(None, map(shutil.which, names)), None)


_LEFT = (
    "Inspected target navigated or closed",
    "Execution context was destroyed",
    "Cannot find default execution context",
    "Cannot find context with specified id",
)
"""What the browser answers to a question that the next document came in between."""


class PageLeftError(AssertionError):
    """The page loaded another document before it had answered."""


class Page:
    """One open page: what it asked for, what it complained about, what it answers."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.events: list[dict[str, Any]] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one DevTools command and return its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                if str(answer.get("error", {}).get("message", "")).startswith(_LEFT):
                    raise PageLeftError(answer)
                assert "error" not in answer, answer
                return answer["result"]
            self.events.append(answer)

    def ask(self, expression: str) -> Any:
        """The value of a JavaScript expression; promises are awaited."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, expression: str, *, limit_s: float = 60.0) -> None:
        """Return when a JavaScript expression becomes true, in this document or the next one."""
        end, found = time.monotonic() + limit_s, False
        while not found:
            with contextlib.suppress(PageLeftError):
                found = self.ask(expression)
            assert found or time.monotonic() < end, f"never true: {expression}"
            if not found:
                time.sleep(0.25)

    def requests(self) -> list[str]:
        """Every address that was asked for."""
        sent = [e for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in sent]

    def complaints(self) -> list[str]:
        """Uncaught exceptions and errors in the log."""
        thrown = [str(e) for e in self.events if e.get("method") == "Runtime.exceptionThrown"]
        entries = [e["params"]["entry"] for e in self.events if e.get("method") == "Log.entryAdded"]
        return thrown + [entry["text"] for entry in entries if entry["level"] == "error"]

    def press(self, key: str, code: str, *, modifiers: int = 0) -> None:
        """Press and release a key, as a person does; 8 is shift."""
        text = {"text": key} if len(key) == 1 else {}
        numbers = {
            "Tab": 9, "Enter": 13,
            "ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40,
        }  # fmt: skip
        number = numbers.get(key) or ord(key.upper())
        same = {"key": key, "code": code, "windowsVirtualKeyCode": number, "modifiers": modifiers}
        text = {"text": "\r"} if key == "Enter" else text
        self.call("Input.dispatchKeyEvent", type="keyDown", **same, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **same)

    def picture(self, clip: dict[str, float] | None = None) -> bytes:
        """What is seen, or a part of it, as PNG."""
        part = {} if clip is None else {"clip": {**clip, "scale": 1}}
        shot = self.call("Page.captureScreenshot", format="png", **part)
        return base64.b64decode(shot["data"])


MOVE_BAR = """(async () => {
  const bar = document.querySelector('#time'), canvas = document.querySelector('canvas');
  const began = performance.now();
  bar.value = %d;
  bar.dispatchEvent(new Event('input'));
  while (canvas.dataset.step !== '%d') await new Promise(requestAnimationFrame);
  return performance.now() - began;
})()"""
"""Moves the time bar of a page; how many milliseconds until the scene has followed."""


def scene_picture(page: Page, element: str = "canvas") -> np.ndarray:
    """An element of the page when it has been drawn, RGB; the scene by default."""
    page.ask(f"void document.querySelector('{element}').scrollIntoView({{block: 'center'}})")
    # What was asked for is drawn before the next frame but one, however long a frame takes.
    page.ask("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
             ".then(() => true)")  # fmt: skip
    left, top, width, height = page.ask(
        f"(() => {{ const b = document.querySelector('{element}').getBoundingClientRect();"
        "return [b.left + scrollX, b.top + scrollY, b.width, b.height]; })()"
    )
    shot = page.picture({"x": left, "y": top, "width": width, "height": height})
    return cv2.imdecode(np.frombuffer(shot, np.uint8), 1)[..., ::-1].astype(int)


@contextlib.contextmanager
def opened(program: str, where: Path | str, profile: Path) -> Iterator[Page]:
    """Open a file in a browser that has no network, or the page of a server of our own."""
    command = [program, *SWITCHES, f"--user-data-dir={profile}", "about:blank"]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            port = next(
                found.group(1)
                for line in process.stderr
                if (found := re.search(r"DevTools listening on ws://127\.0\.0\.1:(\d+)/", line))
            )
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=20) as answer:
                tabs = json.load(answer)
            address = next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
            with connect(address, max_size=None) as socket:
                page = Page(socket)
                for domain in ("Page", "Network", "Log", "Runtime"):
                    page.call(f"{domain}.enable")
                page.call(
                    "Network.emulateNetworkConditions",
                    offline=isinstance(where, Path),
                    latency=0,
                    downloadThroughput=-1,
                    uploadThroughput=-1,
                )
                url = where.as_uri() if isinstance(where, Path) else where
                page.call("Page.navigate", url=url)
                page.wait_for("document.readyState === 'complete'")
                yield page
        finally:
            process.terminate()
            process.wait(timeout=20)
