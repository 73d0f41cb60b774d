"""The recording page: the protocol on screen, and in a browser from the first click to the film."""

import time

import chromium
import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.store import read_recording
from clothtrack_capture.live_capture import CapturedFrame
from clothtrack_capture.recording_page import (
    PROTOCOL,
    Session,
    preview_of,
    record_live,
    warnings_of,
)


class Endless:
    """A camera that draws a blue square on a table until it is closed."""

    camera, depth_unit_m = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5), 0.001

    def __init__(self, frames=100_000, pause_s=0.01):
        self._frames, self._pause_s, self.closed = frames, pause_s, False

    def frames(self):
        for number in range(self._frames):
            time.sleep(self._pause_s)
            yield drawn(number)

    def close(self):
        self.closed = True


def drawn(number):
    color = np.full((120, 160, 3), (200, 166, 124), np.uint8)
    color[30:90, 40:120] = (40, 90, 190)
    depth = np.full((120, 160), 0.7)
    depth[30:90, 40:120] = 0.65
    depth[:10] = 0.0
    return CapturedFrame(number / 30.0, color, depth)


def test_a_session_records_the_steps_of_the_protocol(tmp_path):
    source = Endless(frames=40, pause_s=0.0)
    session = Session(source, tmp_path / "film", {"by": "test"})
    assert session.facts()["step"] == -1
    session.advance()
    assert session.facts()["step"] == -1
    session.start()
    for _ in range(10):
        session.advance()
    session.watch()
    recording = session.finish()
    assert source.closed
    assert len(recording.frames) == 40
    marks = recording.provenance["marks"]
    assert [step for step, _ in marks] == [name for name, _ in PROTOCOL]
    assert session.facts()["ended"]


def test_ctrl_c_ends_it_as_soon_as_the_address_is_told(tmp_path):
    def pressed(address):
        raise KeyboardInterrupt

    session = Session(Endless(), tmp_path / "film", {})
    assert record_live(session, opened=pressed) is None
    assert not list(tmp_path.iterdir())


def test_a_time_limit_ends_the_recording(tmp_path):
    session = Session(Endless(), tmp_path / "film", {})
    session.start()
    session.watch(0.3)
    assert 3 <= len(session.finish().frames) <= 40


def test_what_is_wrong_with_the_picture_is_said():
    good = drawn(0)
    assert warnings_of(good) == []
    assert warnings_of(None) == ["no picture yet"]
    assert "nothing is written any more" in warnings_of(good, "the disk is full")[0]
    blind = CapturedFrame(0.0, None, np.where(np.arange(160) < 40, 3.0, 0.0) * np.ones((120, 1)))
    told = " ".join(warnings_of(blind))
    assert "25 % of the picture" in told
    assert "3.00 m away" in told
    assert "no color" in told


def test_the_preview_shows_near_red_and_nothing_pale():
    picture = preview_of(drawn(0)).astype(int)
    assert picture.shape == (480, 1280, 3)
    near, far, none = picture[240, 960], picture[450, 700], picture[10, 960]
    assert near[0] > near[2]
    assert far[2] > far[0]
    assert none.min() > 230


@pytest.mark.slow
@pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine")
def test_a_browser_leads_through_the_protocol(tmp_path, served):
    session = Session(Endless(), tmp_path / "film", {})
    recorded = served(lambda stop, opened: record_live(session, opened=opened), session.stop)
    with recorded as page, page.browsed(tmp_path) as shown:
        lead_through(shown)
    recording = read_recording(tmp_path / "film")
    assert len(recording.frames) == len(recorded.kept.frames) > 10
    starts = [frame for _, frame in recording.provenance["marks"]]
    assert starts == sorted(starts)
    assert starts[0] == 0
    assert starts[-1] > 0


def lead_through(page):
    """Start, press space through all steps, finish."""
    page.wait_for("document.querySelector('#preview') && "
                  "document.querySelector('#preview').naturalWidth === 1280")  # fmt: skip
    page.wait_for("document.querySelector('#go').disabled === false")
    assert "start" in page.ask("document.querySelector('#order').textContent")
    page.ask("document.querySelector('#go').click()")
    for number, (name, words) in enumerate(PROTOCOL):
        page.wait_for(f"document.querySelector('#order').textContent === {words!r}")
        assert page.ask("document.querySelector('#steps .now').textContent") == name
        assert page.ask("document.querySelectorAll('#steps .done').length") == number
        for kind in ("keyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key=" ", code="Space", text=" ")
    page.wait_for("facts.written > 10")
    page.ask("document.querySelector('#finish').click()")
    page.wait_for("document.querySelector('#order').textContent.includes('is written')")
    assert page.complaints() == []
