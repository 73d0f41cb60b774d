"""The page as a person meets it: opened from disk, in a browser, without a network."""

import importlib.util
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.evaluation.label_review import LabelReview, read_review
from clothtrack.evaluation.truth import Truth
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.report.overlay import OverlayConfig
from clothtrack.report.page import ReportConfig, write_report

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)
MOVE_BAR, scene_picture = chromium.MOVE_BAR, chromium.scene_picture

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine"),
]

SMALL = ReportConfig(overlay=OverlayConfig(height=120))


VERDICTS = "[...document.querySelectorAll('.verdict')].map((one) => one.textContent)"
HIGHLIGHTED = "document.querySelector('#review .current .jump').textContent"


def cloth_pixels(picture):
    """Blue or ochre pixels."""
    return int((np.abs(picture[..., 0] - picture[..., 2]) > 50).sum())


def set_control(page, name, value, event="input"):
    page.ask(
        f"(() => {{ const one = document.querySelector('[name={name}]'); one.value = '{value}';"
        f"one.dispatchEvent(new Event('{event}')); }})()"
    )
    time.sleep(0.5)


@pytest.fixture
def opened(tracked, request, tmp_path):
    """Opens the report of a recording."""

    def open_report(recording, shown=tracked, **options):
        path = tmp_path / "fold.html"
        write_report(shown, request.getfixturevalue(recording), path, config=SMALL, **options)
        return chromium.opened(chromium.find_chromium(), path, tmp_path / "profile")

    return open_report


@pytest.mark.parametrize("recording", ["two_cameras", "clouds_only"])
def test_the_page_plays_offline(opened, recording):
    with opened(recording) as page:
        page.wait_for("document.body.dataset.ready === 'yes'")
        page.wait_for("document.querySelector('video').readyState >= 2")
        assert page.ask("document.querySelector('video').error") is None
        cursor = "document.querySelector('.cursor').getAttribute('x1')"
        start = page.ask(cursor)
        page.ask("void document.querySelector('#play').click()")
        page.wait_for(f"{cursor} !== '{start}'")
        page.wait_for("Number(document.querySelector('canvas').dataset.step) > 0")
        assert page.ask("document.querySelector('.now').textContent").strip()
        own = ("file:", "data:", "blob:", "about:")
        outside = [url for url in page.requests() if not url.startswith(own)]
        assert outside == []
        assert page.complaints() == []


def test_layers_come_apart_and_let_look_through(opened):
    with opened("two_cameras") as page:
        page.wait_for("document.body.dataset.ready === 'yes'")
        page.ask(MOVE_BAR % (5, 5))
        before = scene_picture(page)
        set_control(page, "gap", 0.04)
        apart = scene_picture(page)
        assert cloth_pixels(apart) > 1.1 * cloth_pixels(before)
        set_control(page, "gap", 0)
        assert np.abs(scene_picture(page) - before).max() < 30
        set_control(page, "opacity", 0.3)
        assert cloth_pixels(scene_picture(page)) < 0.8 * cloth_pixels(before)
        assert page.complaints() == []


def test_the_cloth_takes_the_colors_that_are_chosen(opened, tracked):
    rest = tracked.mesh.vertices
    known = replace(tracked, mesh=ClothMesh(rest, tracked.mesh.faces, rest))
    positions = known.positions.astype(float) + (0.0, 0.0, 0.02)
    truth = Truth(positions, known.mesh.faces, known.frames, rest)
    with opened("two_cameras", known, truth=truth) as page:
        page.wait_for("document.body.dataset.ready === 'yes'")
        page.ask("void document.querySelector('[name=cloud]').click()")
        pictures = []
        for mode in ("sides", "visible", "cloud", "label", "truth"):
            set_control(page, "mode", mode, "change")
            page.wait_for(f"document.querySelector('canvas').dataset.mode === '{mode}'")
            pictures.append(scene_picture(page))
            assert page.ask("document.querySelector('.meaning').textContent").strip()
        red = [(p[..., 0] - p[..., 2] > 60).sum() for p in pictures]
        assert red[-1] > 2000  # all of the cloth is 20 mm off: the end of the scale
        assert red[1] < 200
        note = page.ask("document.querySelector('.controls .note').textContent")
        assert "simulated world" in note


@pytest.mark.parametrize(
    ("keys", "verdicts", "label", "frame"),
    [
        (["a", "ArrowDown", "r"], ["accepted", "rejected"], 2, 5),
        (["a", "r"], ["accepted", "rejected"], 2, 5),
        (["ArrowDown", "ArrowUp", "r", "a"], ["rejected", "accepted"], 2, 5),
        (["ArrowRight", "ArrowRight", "ArrowRight", "r"], ["open", "rejected"], 2, 5),
        (["a", "u"], ["open", "open"], 1, 2),
        (["a", "ArrowUp", "r", "u"], ["accepted", "open"], 1, 2),
        (["a", "r", "u", "u", "u"], ["open", "open"], 1, 2),
    ],
)
def test_a_key_decides_the_highlighted_label_only(opened, keys, verdicts, label, frame):
    with opened("two_cameras") as page:
        page.wait_for("document.body.dataset.ready === 'yes'")
        for key in keys:
            page.press(key, key if len(key) > 1 else f"Key{key.upper()}")
        assert page.ask(VERDICTS) == verdicts
        assert page.ask(HIGHLIGHTED) == f"Label {label}"
        assert page.ask("document.querySelector('#told').textContent").startswith(f"frame {frame},")
        assert page.complaints() == []


def test_a_review_by_keys_becomes_a_file_that_label_honours(opened, tracked, tmp_path):
    with opened("two_cameras") as page:
        page.wait_for("document.body.dataset.ready === 'yes'")
        page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
        for key, code in (
            ("a", "KeyA"),
            ("ArrowDown", "ArrowDown"),
            ("r", "KeyR"),
            ("ArrowLeft", "ArrowLeft"),
        ):
            page.press(key, code)
        assert page.ask(VERDICTS) == ["accepted", "rejected"]
        assert page.ask("document.querySelector('#told').textContent").startswith("frame 4")
        page.ask("void document.querySelector('#save').click()")
        path = tmp_path / f"{tracked.name}.review.json"
        for _ in range(100):
            written = [one for one in tmp_path.glob("*.json") if one.stat().st_size]
            if written:
                break
            time.sleep(0.1)
        (found,) = written
        expected = LabelReview.blank(tracked).decided(0, "accepted").decided(1, "rejected")
        assert json.loads(found.read_text()) == expected.as_document()
        found.rename(path)
        assert read_review(path, tracked).rejected == {1}
