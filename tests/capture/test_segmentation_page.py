"""The segmentation page as a person meets it: one click in a browser, and the masks are there."""

import importlib.util
import json
import threading
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack_capture.click_pages import segment_live
from clothtrack_capture.mask_pictures import masked_picture, spread, write_mask_sheet
from clothtrack_capture.segmentation_setup import SegmentationSetup

_spec = importlib.util.spec_from_file_location(
    "chromium", Path(__file__).parents[1] / "report" / "chromium.py"
)
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)

CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5)


def cloth_mask(frame):
    mask = np.zeros((120, 160), dtype=bool)
    mask[20 + 5 * frame : 90, 30:120] = True
    return mask


@pytest.fixture
def recording(tmp_path):
    """A blue cloth that shrinks on a wooden table, over six frames."""
    with RecordingWriter(tmp_path / "film", [CAMERA], {"top": 0.001}) as writer:
        for frame in range(6):
            color = np.full((120, 160, 3), (200, 166, 124), np.uint8)
            color[cloth_mask(frame)] = (40, 90, 190)
            writer.add_frame(
                0.1 * frame, color={"top": color}, depth={"top": np.full((120, 160), 0.6)}
            )
    return read_recording(tmp_path / "film")


def blueness(picture):
    return (picture[..., 2].astype(int) - picture[..., 0] > 60).mean()


def test_a_masked_picture_keeps_the_cloth_and_turns_down_the_rest(recording):
    color = SegmentationSetup(recording, CAMERA).picture(0)
    shown = masked_picture(color, cloth_mask(0), width=160)
    assert shown.shape == color.shape
    np.testing.assert_array_equal(shown[30:80, 40:110], color[30:80, 40:110])
    calm = shown[2:15, 2:15].astype(int)
    assert np.ptp(calm, axis=2).max() < 30
    np.testing.assert_array_equal(masked_picture(color, None, width=160), color)


def test_a_sheet_shows_frames_from_all_over(recording, tmp_path):
    setup = SegmentationSetup(recording, CAMERA)
    setup.choose_click(0, (70, 50))
    path = write_mask_sheet(setup, tmp_path / "sheet.png")
    sheet = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    count = min(len(setup.frames), 20)
    rows = -(-count // 5)
    assert sheet.shape == (rows * (225 + 24), 5 * 300, 3)
    shares = [
        blueness(cell[:225]) for row in np.split(sheet, rows) for cell in np.split(row, 5, axis=1)
    ][:count]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.25
    assert spread(list(range(100)), 5) == [0, 25, 50, 74, 99]


def test_stopping_without_keeping_leaves_the_recording_alone(recording):
    before = (recording.folder / "recording.json").read_bytes()
    stop = threading.Event()
    kept = segment_live(
        SegmentationSetup(recording, CAMERA), stop=stop, opened=lambda _: stop.set()
    )
    assert kept is None
    assert (recording.folder / "recording.json").read_bytes() == before


def test_a_click_beside_the_cloth_is_answered_with_what_to_do():
    film = read_recording(shipped_recording())
    setup = SegmentationSetup(film, film.cameras[0])
    answers = []

    def click(address):
        request = urllib.request.Request(
            address + "choose",
            b'{"frame": 0, "click": [3, 3]}',
            {"Content-Type": "application/json"},
        )
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(request, timeout=20)
        answers.append((refused.value.code, json.loads(refused.value.read())["error"]))
        stop.set()

    stop = threading.Event()
    assert segment_live(setup, stop=stop, opened=click) is None
    [(status, told)] = answers
    assert status == 422
    assert "click (3, 3)" in told
    assert "click on the cloth" in told
    assert not setup.chosen


@pytest.mark.slow
@pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("how", ["click", "box"])
def test_one_click_in_a_browser_shows_all_masks_and_keeps_them(recording, tmp_path, how):
    found: dict[str, int | None] = {}
    address, ready, stop = [], threading.Event(), threading.Event()

    def opened(where):
        address.append(where)
        ready.set()

    thread = threading.Thread(
        target=lambda: found.update(
            kept=segment_live(SegmentationSetup(recording, CAMERA), stop=stop, opened=opened)
        )
    )
    thread.start()
    try:
        assert ready.wait(20)
        blank = tmp_path / "blank.html"
        blank.write_text("<title>blank</title>")
        with chromium.opened(chromium.find_chromium(), blank, tmp_path / "profile") as page:
            look_through(page, address[0], how)
    finally:
        stop_later = threading.Timer(20, stop.set)
        stop_later.start()
        thread.join(timeout=30)
        stop_later.cancel()
    assert sum("top" in frame.mask for frame in found["kept"].frames) == 6
    again = read_recording(recording.folder)
    for frame in again.frames:
        mask = read_mask(frame.mask["top"])
        true = cloth_mask(frame.index)
        assert (mask & true).sum() / (mask | true).sum() > 0.95


# Blue pixels of a shown picture, read back from a canvas.
COUNT = """(() => { const i = document.querySelector('%s'); if (!i.complete) return -1;
const c = document.createElement('canvas'); c.width = 80; c.height = 60;
const g = c.getContext('2d'); g.drawImage(i, 0, 0, 80, 60);
const d = g.getImageData(0, 0, 80, 60).data; let n = 0;
for (let k = 0; k < d.length; k += 4) if (d[k + 2] - d[k] > 60) n += 1; return n; })()"""
CALM = """(() => { const i = document.querySelector('#large'); if (!i.complete) return false;
const c = document.createElement('canvas'); c.width = 80; c.height = 60;
const g = c.getContext('2d'); g.drawImage(i, 0, 0, 80, 60);
const d = g.getImageData(3, 3, 1, 1).data; return d[0] - d[2] < 40; })()"""


def look_through(page, address, how):
    """Choose, look at every frame, keep."""
    page.call(
        "Network.emulateNetworkConditions",
        offline=False, latency=0, downloadThroughput=-1, uploadThroughput=-1,
    )  # fmt: skip
    page.call("Page.navigate", url=address)
    page.wait_for("!!document.querySelector('#grid figure img') && facts !== null")
    page.wait_for("document.querySelector('#first').naturalWidth > 0")
    assert page.ask("document.querySelector('#keep').disabled") is True
    assert page.ask(CALM) is False
    left, top, width = page.ask(
        "(() => { const b = document.querySelector('#first').getBoundingClientRect();"
        "return [b.left, b.top, b.width]; })()"
    )
    scale = width / 160.0
    start, end = ((70, 50), (70, 50)) if how == "click" else ((25, 15), (126, 96))
    for kind, (x, y) in (("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
        page.call(
            "Input.dispatchMouseEvent", type=kind, x=left + scale * x, y=top + scale * y,
            button="left", buttons=1, clickCount=1,
        )  # fmt: skip
    page.wait_for("document.querySelector('#keep').disabled === false")
    # All that is not cloth is turned down, in the large picture and in every small one.
    page.wait_for(CALM)
    counts = []
    for place in range(6):
        page.ask(
            f"(() => {{ const s = document.querySelector('#slider'); s.value = {place};"
            "s.dispatchEvent(new Event('input')); })()"
        )
        page.wait_for(f"document.querySelector('#told').value.includes('frame {place} ·')")
        page.wait_for("document.querySelector('#large').complete")
        counts.append(page.ask(COUNT % "#large"))
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0]
    assert page.ask("document.querySelectorAll('#grid figure').length") == 6
    assert page.ask(COUNT % "#grid figure img") > 500
    page.ask("document.querySelector('#keep').click()")
    page.wait_for("document.querySelector('#words').textContent.includes('masks are in')")
    assert all(url.startswith((address, "data:", "file:")) for url in page.requests())
    assert page.complaints() == []
