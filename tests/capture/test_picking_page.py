"""The page for a bare hand as a person meets it: scrub, click, undo, save."""

import importlib.util
import json
import shutil
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

import clothtrack as ct
from clothtrack_capture.click_pages import pick_live
from clothtrack_capture.clicked_picking import ClickedPicking

_spec = importlib.util.spec_from_file_location(
    "chromium", Path(__file__).parents[1] / "report" / "chromium.py"
)
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)


@pytest.fixture
def folder(tmp_path):
    """The shipped recording as a hand leaves it: without a path, without actions."""
    copy = tmp_path / "film"
    shutil.copytree(ct.shipped_recording(), copy)
    (copy / "picker.csv").unlink()
    document = json.loads((copy / "recording.json").read_text())
    del document["actions"]
    (copy / "recording.json").write_text(json.dumps(document))
    return copy


class Served:
    """The page of a recording, on a thread of its own while the block runs."""

    def __init__(self, folder):
        recording = ct.read_recording(folder)
        self._picking = ClickedPicking(recording, recording.cameras[0])
        self._stop, self._ready = threading.Event(), threading.Event()
        self.address, self.kept = "", None

    def __enter__(self):
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        assert self._ready.wait(20)
        return self

    def __exit__(self, *failure):
        if failure[0] is None:
            self._thread.join(timeout=10)
        self._stop.set()
        self._thread.join(timeout=20)

    def _serve(self):
        self.kept = pick_live(self._picking, "hand", stop=self._stop, opened=self._opened)

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

    def leave(self):
        self._stop.set()


def test_leaving_without_saving_leaves_the_recording_alone(folder):
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    with Served(folder) as page:
        assert page.tell("click", {"frame": 4, "click": [250, 63]})[0] == 200
        page.leave()
    assert page.kept is None
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before


def test_every_wrong_message_is_answered_with_one_line_and_the_page_lives_on(folder):
    with Served(folder) as page:
        for path, message, status, told in (
            ("keep", {}, 422, "nothing is clicked yet"),
            ("click", {"frame": 2, "click": [3, 3]}, 422, "click on the cloth"),
            ("click", {"frame": 99, "click": [250, 63]}, 422, "from 0 to 42"),
            ("click", {"frame": "x", "click": [250, 63]}, 400, "not understood"),
            ("click", {"frame": 2}, 400, "not understood"),
        ):
            answer = page.tell(path, message)
            assert answer[0] == status
            assert told in answer[1]["error"]
            assert "\n" not in answer[1]["error"]
        page.tell("click", {"frame": 4, "click": [250, 63]})
        early = page.tell("click", {"frame": 3, "click": [217, 127]})
        assert (early[0], "is not after the pick" in early[1]["error"]) == (422, True)
        status, facts = page.tell("click", {"frame": 15, "click": [217, 127]})
        assert status == 200
        (action,) = facts["actions"]
        assert action["path"][0][0] >= 2
        assert len(action["path"]) >= 12
        assert page.tell("undo", {})[1]["clicks"] == [[4, 250, 63]]
        page.leave()
    assert page.kept is None


@pytest.mark.slow
@pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine")
def test_two_actions_are_clicked_in_a_browser_and_saved(folder, tmp_path):
    blank = tmp_path / "blank.html"
    blank.write_text("<title>blank</title>")
    with (
        Served(folder) as served,
        chromium.opened(chromium.find_chromium(), blank, tmp_path / "profile") as page,
    ):
        page.call(
            "Network.emulateNetworkConditions",
            offline=False, latency=0, downloadThroughput=-1, uploadThroughput=-1,
        )  # fmt: skip
        page.call("Page.navigate", url=served.address)
        page.wait_for("!!document.querySelector('#list li') && wanted === null")
        assert page.ask("document.querySelector('#save').disabled") is True
        for frame, column, row in ((4, 250, 63), (15, 217, 127), (23, 55, 86)):
            click(page, frame, column, row)
        assert page.ask("document.querySelector('#next').textContent").startswith("Place")
        assert page.ask("document.querySelectorAll('#list li').length") == 2
        # Before its pick: refused in words, and nothing is lost.
        click(page, 20, 132, 97)
        assert "is not after the pick" in page.ask("document.querySelector('#words').textContent")
        assert page.ask("facts.clicks.length") == 3
        click(page, 38, 100, 200)
        page.press("u", "KeyU")
        page.wait_for("!busy && facts.clicks.length === 3")
        page.press("ArrowRight", "ArrowRight")
        assert page.ask("now") == 39
        click(page, 39, 132, 97)
        # The dot is near the fingers while they carry the cloth.
        page.ask("show(30)")
        assert page.ask("document.querySelectorAll('#marks [fill=\"#ffd54a\"]').length") == 1
        for width in (390, 2560):
            page.call(
                "Emulation.setDeviceMetricsOverride",
                width=width, height=844, deviceScaleFactor=1, mobile=width < 400,
            )  # fmt: skip
            assert page.ask("document.documentElement.scrollWidth") <= width
        page.press("s", "KeyS")
        page.wait_for("saved")
        assert "2 actions are in the recording" in page.ask(
            "document.querySelector('#words').textContent"
        )
        assert all(url.startswith((served.address, "data:", "file:")) for url in page.requests())
        # The refused click is the only thing that the browser complains about.
        assert [text for text in page.complaints() if "422" not in text] == []
    assert len(served.kept.actions) == 2
    assert len(ct.read_recording(folder).actions) == 2


def click(page, frame, column, row):
    """Go to a frame and click on one of its pixels, as a mouse does."""
    page.ask(f"show({frame})")
    page.wait_for("wanted === null")
    left, top, width = page.ask(
        "(() => { const b = document.querySelector('#frame').getBoundingClientRect();"
        "return [b.left, b.top, b.width]; })()"
    )
    spot = {"x": left + (column + 0.5) * width / 320, "y": top + (row + 0.5) * width / 320}
    page.call("Input.dispatchMouseEvent", type="mouseMoved", **spot)
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, **spot, button="left", buttons=1, clickCount=1
        )
    page.wait_for("!busy")
