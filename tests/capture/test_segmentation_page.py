"""The segmentation page as a person meets it: one click in a browser, and the masks are there."""

from functools import partial

import chromium
import cv2
import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack_capture.click_pages import segment_live
from clothtrack_capture.mask_pictures import (
    MaskSummary,
    doubtful,
    masked_picture,
    spread,
    write_mask_sheet,
)
from clothtrack_capture.segmentation_setup import SegmentationSetup

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


def test_a_fold_that_halves_the_area_slowly_is_no_doubt():
    assert not doubtful(np.linspace(6000.0, 3000.0, 40)).any()


def test_a_piece_that_is_lost_and_a_gain_are_named():
    areas = np.full(30, 5000.0)
    areas[12], areas[20], areas[25] = 3000.0, 7000.0, 0.0
    assert np.flatnonzero(doubtful(areas)).tolist() == [12, 20, 25]


def test_it_says_how_much_is_cloth_and_where_to_look():
    summary = MaskSummary(26, 4100, 0.14, 0.17, 20, tuple(range(10)))
    first, second = str(summary).splitlines()
    assert first == (
        "26 frames with cloth, 14.0 to 17.0 % of the picture (median 4100 pixels); smallest in "
        "frame 20"
    )
    assert second.startswith("look at frames 0, 1, 2, 3, 4, 5, 6, 7 and 2 more: ")


def test_a_wrong_click_is_answered_and_what_is_kept_ends_the_page(recording, served, contents):
    before = contents(recording.folder)
    page = served(partial(segment_live, SegmentationSetup(recording, CAMERA)))
    with page:
        status, told = page.tell("choose", {"frame": 0, "click": [500, 3]})
        assert status == 422
        assert "outside the picture" in told["error"]
        assert contents(recording.folder) == before
        assert page.tell("choose", {"frame": 0, "box": [25, 15, 126, 96]})[1]["chosen"]
        page.tell("keep", {})
    assert sum("top" in frame.mask for frame in page.kept.frames) == 6


@pytest.mark.slow
@pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize("how", ["click", "box"])
def test_one_click_in_a_browser_shows_all_masks_and_keeps_them(recording, tmp_path, served, how):
    page = served(partial(segment_live, SegmentationSetup(recording, CAMERA)))
    with page, page.browsed(tmp_path) as shown:
        look_through(shown, how)
    assert sum("top" in frame.mask for frame in page.kept.frames) == 6
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


def look_through(page, how):
    """Choose, look at every frame, keep."""
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
    assert page.complaints() == []
