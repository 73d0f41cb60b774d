"""The shipped recording as a hand leaves it, a printed board in a picture, and a served page."""

import contextlib
import importlib.util
import json
import shutil
import sys
import threading
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest

import clothtrack as ct

if "chromium" not in sys.modules:
    _path = Path(__file__).parents[1] / "report" / "chromium.py"
    _spec = importlib.util.spec_from_file_location("chromium", _path)
    sys.modules["chromium"] = importlib.util.module_from_spec(_spec)
    _spec.loader.exec_module(sys.modules["chromium"])
chromium = sys.modules["chromium"]


@pytest.fixture
def folder(tmp_path):
    """The shipped recording as a hand leaves it: without a path, without actions."""
    copy = tmp_path / "film"
    shutil.copytree(ct.shipped_recording(), copy)
    (copy / "picker.csv").unlink()
    document = json.loads((copy / "recording.json").read_text())
    del document["actions"]
    document["cloth"]["grasp_uncertainty_m"] = 0.03
    (copy / "recording.json").write_text(json.dumps(document))
    return copy


@pytest.fixture
def contents():
    """Reads all files of a folder, to compare them later."""
    return lambda folder: {path: path.read_bytes() for path in folder.rglob("*.*")}


@pytest.fixture
def board_picture():
    """Draws a board at a pose in a camera's frame, four times oversampled, on a gray table."""

    def drawn(camera, pose, board, pixels=60, over=4):
        picture = board.picture(pixels)
        height, width = picture.shape
        # Pixels of the print to meters on the board, to pixels of the camera, to fine pixels.
        scale = board.square_m / pixels
        to_board = np.array(
            [[scale, 0, (0.5 - width / 2) * scale], [0, -scale, (height / 2 - 0.5) * scale],
             [0, 0, 1]]
        )  # fmt: skip
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        fine = np.array([[over, 0, (over - 1) / 2], [0, over, (over - 1) / 2], [0, 0, 1]])
        mapping = fine @ matrix @ pose[:3][:, [0, 1, 3]] @ to_board
        size = camera.width * over, camera.height * over
        shown = cv2.warpPerspective(picture, mapping, size, borderValue=200)
        shown = cv2.resize(shown, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return np.repeat(shown[..., None], 3, axis=2)

    return drawn


class Served:
    """A page on a thread of its own while the block runs; `kept` is what it gives in the end."""

    def __init__(self, live, stop=None):
        self._live, self.stop, self._ready = live, stop or threading.Event(), threading.Event()
        self.address, self.kept = "", None

    def __enter__(self):
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        assert self._ready.wait(20)
        return self

    def __exit__(self, *failure):
        if failure[0] is None:
            self._thread.join(timeout=30)
        self.stop.set()
        self._thread.join(timeout=30)

    def _serve(self):
        self.kept = self._live(stop=self.stop, opened=self._opened)

    def _opened(self, address):
        self.address = address
        self._ready.set()

    def tell(self, path, message):
        """The status of an answer, and what it holds."""
        request = urllib.request.Request(
            self.address + path, json.dumps(message).encode(), {"Content-Type": "application/json"}
        )
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as refused:
            return refused.code, json.load(refused)

    @contextlib.contextmanager
    def browsed(self, folder):
        """The page in a browser, which asks nobody else."""
        blank = folder / "blank.html"
        blank.write_text("<title>blank</title>")
        with chromium.opened(chromium.find_chromium(), blank, folder / "profile") as page:
            page.call(
                "Network.emulateNetworkConditions",
                offline=False, latency=0, downloadThroughput=-1, uploadThroughput=-1,
            )  # fmt: skip
            page.call("Page.navigate", url=self.address)
            yield page
            assert all(url.startswith((self.address, "data:", "file:")) for url in page.requests())


@pytest.fixture
def served():
    """Serves a page: `served(live)` of a function of `stop` and `opened`."""
    return Served
