"""The live page: served on this machine only, judged by keys, quick enough to scrub."""

import gc
import http.client
import importlib.util
import logging
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import viser
import zstandard
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.label_review import LabelReview, read_review
from clothtrack.report.live import LivePage, view_live
from clothtrack.report.scene import local_server

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)

# The server's event loop may end before it has seen its client go; what it then leaves is found
# here, and not in whatever test comes next.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
in_browser = pytest.mark.skipif(
    chromium.find_chromium() is None, reason="no Chromium on this machine"
)


@contextmanager
def served(tracked, recording, caplog, **options):
    """The address of a page that is served while this is open."""
    stop = threading.Event()
    caplog.set_level(logging.INFO, logger="clothtrack")
    thread = threading.Thread(
        target=view_live, args=(tracked, recording), kwargs={"stop": stop, **options}
    )
    thread.start()
    try:
        for _ in range(400):
            found = re.search(r"http://(127\.0\.0\.1):(\d+)", caplog.text)
            if found:
                break
            time.sleep(0.05)
        assert found, "the address was not logged"
        yield found.group(1), int(found.group(2))
    finally:
        stop.set()
        thread.join(timeout=20)
    assert not thread.is_alive()
    gc.collect()


def test_the_page_is_served_until_it_is_stopped(tracked, clouds_only, caplog):
    with served(tracked, clouds_only, caplog) as address:
        connection = http.client.HTTPConnection(*address, timeout=10)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200
        connection.close()


def test_a_port_that_cannot_be_is_refused_and_not_waited_for(tracked, clouds_only):
    with pytest.raises(InvalidConfigError, match="port is 99999; choose one"):
        view_live(tracked, clouds_only, 99_999)


@pytest.fixture
def page(tracked, clouds_only, tmp_path):
    """The controls without a browser."""
    page = LivePage(tracked, clouds_only)
    with local_server() as server:
        page.build(server, LabelReview.blank(tracked), tmp_path / "fold.review.json")
        yield page
    gc.collect()


def test_steps_stay_inside_and_labels_are_found(page, tracked):
    page.step_by(-1)
    assert page._frame.value == 0
    page.label_by(-1)
    assert tracked.frames[page._frame.value] == 2
    page.label_by(1)
    assert tracked.frames[page._frame.value] == 5
    page.label_by(1)
    page.step_by(1)
    assert tracked.frames[page._frame.value] == 5
    page.label_by(-1)
    assert tracked.frames[page._frame.value] == 2


PRESS = {
    "a": lambda page: page.decide("accepted"),
    "r": lambda page: page.decide("rejected"),
    "o": lambda page: page.decide("open"),
    "u": lambda page: page.undo(),
    "down": lambda page: page.label_by(1),
    "up": lambda page: page.label_by(-1),
    "right": lambda page: page.step_by(1),
}


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("a down r", ("accepted", "rejected", 2, 5)),
        ("a r", ("accepted", "rejected", 2, 5)),
        ("a", ("accepted", "open", 2, 5)),
        ("down r", ("open", "rejected", 2, 5)),
        ("down up r a", ("rejected", "accepted", 2, 5)),
        ("right right right r", ("open", "rejected", 2, 5)),
        ("a u", ("open", "open", 1, 2)),
        ("a r u", ("accepted", "open", 2, 5)),
        ("a up r u", ("accepted", "open", 1, 2)),
        ("a up o", ("open", "open", 2, 5)),
        ("a r u u u", ("open", "open", 1, 2)),
        ("u", ("open", "open", 1, 0)),
    ],
)
def test_a_key_decides_the_highlighted_label_only(page, tracked, tmp_path, keys, expected):
    for key in keys.split():
        PRESS[key](page)
    written = read_review(tmp_path / "fold.review.json", tracked).labels
    highlighted = re.search(r'class="current"><th>Label (\d)<', page._verdicts.content).group(1)
    frame = tracked.frames[page._frame.value]
    assert (*(one.verdict for one in written), int(highlighted), frame) == expected


def test_two_actions_that_meet_in_a_frame_keep_their_own_labels(tracked, clouds_only, tmp_path):
    first, second = tracked.actions
    meeting = replace(tracked, actions=(first, replace(second, first_frame=2)))
    page = LivePage(meeting, clouds_only)
    with local_server() as server:
        page.build(server, LabelReview.blank(meeting), tmp_path / "fold.review.json")
        page.decide("accepted")
        page.label_by(-1)
        page.decide("rejected")
        assert page._review.rejected == {0}
    gc.collect()


def test_keys_in_quick_succession_decide_one_label_each(page):
    """viser runs what keys do on threads of its own."""
    with ThreadPoolExecutor() as threads:
        list(threads.map(page.decide, ("accepted", "accepted")))
    assert [one.verdict for one in page._review.labels] == ["accepted", "accepted"]


def test_the_slider_of_one_frame_leads_nowhere(one_frame, clouds_only):
    page = LivePage(one_frame, clouds_only)
    with local_server() as server:
        page.build(server, LabelReview.blank(one_frame), None)
        page._frame.value = 1
        page.label_by(1)
        assert "<b>frame 2</b>" in page._told.content
    gc.collect()


def test_every_decision_is_on_the_disk_at_once(page, tracked, tmp_path):
    path = tmp_path / "fold.review.json"
    page.decide("rejected")
    assert read_review(path, tracked).rejected == {0}
    page.decide("accepted")
    verdicts = [one.verdict for one in read_review(path, tracked).labels]
    assert verdicts == ["rejected", "accepted"]


def test_a_decision_that_cannot_be_saved_is_not_taken(page, tmp_path):
    (tmp_path / "file").write_text("")
    page._file = tmp_path / "file" / "fold.review.json"
    page.decide("rejected")
    assert page._review.rejected == frozenset()
    assert "Not saved" in page._saved.content


def test_layers_apart_move_only_what_lies_on_another(page, tracked):
    page.label_by(1)
    page.label_by(1)
    handle = page._cloth._groups["sides"][0]
    before = handle.vertices.copy()
    page._gap.value = 0.1
    page.show()
    moved = (handle.vertices - before)[:, 2]
    assert moved.max() > 0.05
    assert np.abs((handle.vertices - before)[:, :2]).max() < 1e-6
    assert moved.min() > -1e-6


VERDICTS = "[...document.querySelectorAll('.ct .verdict')].map((one) => one.textContent)"
FRAME = "(document.body.innerText.match(/frame (\\d+), [\\d.]+ s/) ?? [])[1]"
CLICK_UNDO = (
    "void [...document.querySelectorAll('button')].find((one) => one.innerText === 'Undo').click()"
)
EYE = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, -1.0),
    "fov": 0.7,
    "near": 0.01,
    "far": 100.0,
    "image_height": 480,
    "image_width": 640,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
SCENE = {"x": 150, "y": 150, "width": 600, "height": 500}


@pytest.mark.slow
@in_browser
def test_keys_move_the_mesh_and_write_the_review(tracked, two_cameras, tmp_path):
    path = tmp_path / "fold.review.json"
    live = LivePage(tracked, two_cameras)
    with local_server() as server:
        live.build(server, LabelReview.blank(tracked), path)
        address = f"http://127.0.0.1:{server.get_port()}"
        with chromium.opened(chromium.find_chromium(), address, tmp_path / "profile") as page:
            page.wait_for(f"{FRAME} === '0' && {VERDICTS}.length === 2")
            page.wait_for("window.clothtrackKeys === true")
            until(lambda: cloth_pixels(page.picture(SCENE)) > 2000)
            first = page.picture(SCENE)
            (client,) = server.get_clients().values()
            eye = np.array(client.camera.position)
            for key, code, then in (
                ("a", "KeyA", f"{VERDICTS}[0] === 'accepted' && {FRAME} === '5'"),
                ("ArrowDown", "ArrowDown", f"{FRAME} === '5'"),
                ("r", "KeyR", f"{VERDICTS}[1] === 'rejected'"),
                ("u", "KeyU", f"{VERDICTS}[1] === 'open'"),
                ("a", "KeyA", f"{VERDICTS}[1] === 'accepted'"),
                ("ArrowLeft", "ArrowLeft", f"{FRAME} === '4'"),
                ("ArrowUp", "ArrowUp", f"{FRAME} === '2'"),
            ):
                page.press(key, code)
                page.wait_for(then)
            page.ask(CLICK_UNDO)
            page.wait_for(f"{VERDICTS}[1] === 'open' && {FRAME} === '5'")
            page.press("r", "KeyR")
            page.wait_for(f"{VERDICTS}[1] === 'rejected'")
            until(lambda: apart(page.picture(SCENE), first) > 0.5)
            np.testing.assert_allclose(client.camera.position, eye)  # viser's own use of the keys
            outside = [url for url in page.requests() if not url.startswith(address)]
            assert [url for url in outside if not url.startswith(("data:", "blob:"))] == []
            assert page.complaints() == []
    verdicts = [one.verdict for one in read_review(path, tracked).labels]
    assert verdicts == ["accepted", "rejected"]
    gc.collect()


def test_a_scrub_is_answered_within_a_tenth_of_a_second(page):
    """From the slider's message on the wire to the moved mesh on the wire, without drawing it."""
    slider = page._frame._impl.uuid
    host, port = page._server.get_host(), page._server.get_port()
    version = [Subprotocol(f"viser-v{viser.__version__}")]
    with connect(f"ws://{host}:{port}", subprotocols=version, max_size=None) as socket:
        socket.send(msgspec.msgpack.encode(EYE))  # who has no eye is no viewer yet
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            _received(socket, 0.5)
        taken_ms = []
        for step in (1, 4, 2, 5, 3):
            update = {"type": "GuiUpdateMessage", "uuid": slider, "updates": {"value": step}}
            began = time.perf_counter()
            socket.send(msgspec.msgpack.encode(update))
            for _ in range(20):
                if b"/cloth/outside" in _received(socket, 1.0):
                    break
            else:
                pytest.fail("the mesh never moved")
            taken_ms.append(1e3 * (time.perf_counter() - began))
    assert min(taken_ms) < 100
    assert page._frame.value == 3


def _received(socket, limit_s):
    """The unpacked words of the next message; empty when there is none for so long."""
    try:
        data = socket.recv(timeout=limit_s)
    except TimeoutError:
        return b""
    size, packed = (int.from_bytes(data[k : k + 8], "little") for k in (0, 8))
    return zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], size)


def until(true, limit_s=90.0):
    """Return when something becomes true."""
    end = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < end, "never true"
        time.sleep(0.5)


def pixels(picture):
    return cv2.imdecode(np.frombuffer(picture, np.uint8), 1).astype(int)


def cloth_pixels(picture):
    """Blue or ochre pixels."""
    shown = pixels(picture)
    return int((np.abs(shown[..., 0] - shown[..., 2]) > 40).sum())


def apart(one, other):
    """Mean difference of two pictures, 0 to 255."""
    return float(np.abs(pixels(one) - pixels(other)).mean())
