"""The page for a bare hand as a person meets it: scrub, click, undo, save."""

from functools import partial

import chromium
import pytest

import clothtrack as ct
from clothtrack_capture.click_pages import pick_live
from clothtrack_capture.clicked_picking import ClickedPicking


@pytest.fixture
def page(served, folder):
    recording = ct.read_recording(folder)
    return served(partial(pick_live, ClickedPicking(recording, recording.cameras[0]), "hand"))


def test_leaving_without_saving_leaves_the_recording_alone(folder, page, contents):
    before = contents(folder)
    with page:
        assert page.tell("click", {"frame": 4, "click": [250, 63]})[0] == 200
        page.stop.set()
    assert page.kept is None
    assert contents(folder) == before


def test_every_wrong_message_is_answered_with_one_line_and_the_page_lives_on(page):
    with page:
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
        status, facts = page.tell("click", {"frame": 15, "click": [217, 127]})
        assert status == 200
        (action,) = facts["actions"]
        assert action["path"][0][0] >= 2
        assert len(action["path"]) >= 12
        assert page.tell("undo", {})[1]["clicks"] == [[4, 250, 63]]
        page.stop.set()


def test_what_is_kept_is_written_and_ends_the_page(folder, page):
    with page:
        page.tell("click", {"frame": 4, "click": [250, 63]})
        page.tell("click", {"frame": 15, "click": [217, 127]})
        assert len(page.tell("keep", {})[1]["actions"]) == 1
    assert page.kept.actions == ct.read_recording(folder).actions


@pytest.mark.slow
@pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine")
def test_two_actions_are_clicked_in_a_browser_and_saved(folder, page, tmp_path):
    with page, page.browsed(tmp_path) as shown:
        shown.wait_for("!!document.querySelector('#list li') && wanted === null")
        assert shown.ask("document.querySelector('#save').disabled") is True
        for frame, column, row in ((4, 250, 63), (15, 217, 127), (23, 55, 86)):
            click(shown, frame, column, row)
        assert shown.ask("document.querySelector('#next').textContent").startswith("Place")
        assert shown.ask("document.querySelectorAll('#list li').length") == 2
        # Before its pick: refused in words, and nothing is lost.
        click(shown, 20, 132, 97)
        assert "is not after the pick" in shown.ask("document.querySelector('#words').textContent")
        assert shown.ask("facts.clicks.length") == 3
        click(shown, 38, 100, 200)
        shown.press("u", "KeyU")
        shown.wait_for("!busy && facts.clicks.length === 3")
        shown.press("ArrowRight", "ArrowRight")
        assert shown.ask("now") == 39
        click(shown, 39, 132, 97)
        # The dot is near the fingers while they carry the cloth.
        shown.ask("show(30)")
        assert shown.ask("document.querySelectorAll('#marks [fill=\"#ffd54a\"]').length") == 1
        for width in (390, 2560):
            shown.call(
                "Emulation.setDeviceMetricsOverride",
                width=width, height=844, deviceScaleFactor=1, mobile=width < 400,
            )  # fmt: skip
            assert shown.ask("document.documentElement.scrollWidth") <= width
        shown.press("s", "KeyS")
        shown.wait_for("saved")
        assert "2 actions are in the recording" in shown.ask(
            "document.querySelector('#words').textContent"
        )
        # The refused click is the only thing that the browser complains about.
        assert [text for text in shown.complaints() if "422" not in text] == []
    assert len(page.kept.actions) == len(ct.read_recording(folder).actions) == 2


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
