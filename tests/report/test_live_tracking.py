"""The page of a tracking that goes on: the newest mesh, how far it is, and how it ended."""

import http.client
import importlib.util
import json
import threading
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from clothtrack.report.live_tracking import live_tracking

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)

WORDS = "document.querySelector('.growing').textContent"


def answer(address, path):
    """What the server says to a question, as JSON where it is."""
    url = urlsplit(address)
    connection = http.client.HTTPConnection(url.hostname, url.port, timeout=10)
    try:
        connection.request("GET", path)
        text = connection.getresponse().read().decode()
    finally:
        connection.close()
    return json.loads(text) if text.startswith("{") else text


@pytest.fixture
def live():
    """A page, its address, and the words that it repeats."""
    addresses, words = [], ["first mesh"]
    with live_tracking(lambda: words[0], opened=addresses.append) as page:
        yield page, addresses[0], words


@pytest.fixture
def show(live, tracked, two_cameras):
    def at(step):
        page, _, words = live
        words[0] = f"frame {step}"
        page.watch(two_cameras, tracked.mesh, two_cameras.frames[step], tracked.positions[step])

    return at


def test_before_there_is_a_mesh_the_page_says_what_is_done(live):
    _, address, _ = live
    assert "first mesh" in answer(address, "/")
    assert answer(address, "/version") == {"version": 0}
    now = answer(address, "/now?after=0")
    assert (now["words"], now["over"]) == ("first mesh", False)
    assert "data" not in now


def test_a_mesh_is_sent_once_and_the_newest_only(live, show):
    _, address, _ = live
    for step in (0, 1, 2):
        show(step)
    assert answer(address, "/version") == {"version": 1}
    first = answer(address, "/now?after=0")
    assert (first["words"], first["known"], first["frame"]) == ("frame 2", 3, 2)
    assert first["data"]
    assert "data" not in answer(address, "/now?after=3")
    # A page without a scene has nowhere to put it.
    assert "data" not in answer(address, "/now?after=-1")


def test_another_cloth_is_another_page(live, show, tracked, two_cameras):
    page, address, _ = live
    show(0)
    page.watch(two_cameras, replace(tracked.mesh), two_cameras.frames[0], tracked.positions[0])
    assert answer(address, "/version") == {"version": 2}


def test_what_is_shown_is_what_it_was_then(live, show, tracked, two_cameras):
    """The tracker goes on in the same memory."""
    page, address, _ = live
    positions = np.array(tracked.positions[0])
    page.watch(two_cameras, tracked.mesh, two_cameras.frames[0], positions)
    before = answer(address, "/now?after=0")["data"]
    positions += 1.0
    assert answer(address, "/now?after=0")["data"] == before


def test_nobody_is_waited_for_where_no_page_is_open(live, show):
    page, _, _ = live
    show(0)
    ended = threading.Thread(target=page.end, args=("trust",))
    ended.start()
    ended.join(1.0)
    assert not ended.is_alive()


def test_an_open_page_hears_the_end(live, show):
    page, address, _ = live
    show(0)
    answer(address, "/now?after=0")
    ended = threading.Thread(target=page.end, args=("out/fold.zarr: trust",))
    ended.start()
    now = answer(address, "/now?after=1")
    ended.join(1.0)
    assert not ended.is_alive()
    assert (now["words"], now["over"]) == ("out/fold.zarr: trust", True)


@pytest.mark.slow
@pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine")
def test_the_scene_follows_in_a_browser(live, show, tmp_path):
    page, address, _ = live
    with chromium.opened(chromium.find_chromium(), address, tmp_path / "profile") as browser:
        assert browser.ask(WORDS) == "first mesh"
        show(0)
        browser.wait_for("document.body?.dataset.frame === '0'")
        flat = chromium.scene_picture(browser)
        show(4)
        browser.wait_for("document.body.dataset.frame === '4'")
        folded = chromium.scene_picture(browser)
        assert (np.abs(flat - folded).max(axis=2) > 50).sum() > 500
        assert browser.ask(WORDS) == "frame 4"
        page.end("trust: expected error 3.1 mm")
        browser.wait_for(f"{WORDS}.startsWith('trust')")
        assert browser.complaints() == []
