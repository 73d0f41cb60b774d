"""The page as a person meets it: opened from disk, in a browser, without a network."""

import base64
import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

from clothtrack.report.overlay import OverlayConfig
from clothtrack.report.page import ReportConfig, write_report

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine"),
]

SCENE = "document.querySelector('iframe').contentDocument"
CLOCK = f"Number({SCENE}.querySelector('input').value)"


def cloth_pixels(page):
    """Blue or ochre pixels inside the scene, away from its time bar and its notices."""
    box = page.ask(
        "(() => { const b = document.querySelector('iframe').getBoundingClientRect();"
        "return [b.left + scrollX, b.top + scrollY, b.width, b.height]; })()"
    )
    left, top, width, height = box
    clip = {
        "x": left + 0.4 * width,
        "y": top + 0.1 * height,
        "width": 0.5 * width,
        "height": 0.75 * height,
        "scale": 1,
    }
    shot = base64.b64decode(page.call("Page.captureScreenshot", format="png", clip=clip)["data"])
    blue, _, red = np.moveaxis(cv2.imdecode(np.frombuffer(shot, np.uint8), 1).astype(int), 2, 0)
    return int((np.abs(red - blue) > 50).sum())


@pytest.mark.parametrize("recording", ["two_cameras", "clouds_only"])
def test_the_page_plays_offline(tracked, recording, request, tmp_path):
    path = tmp_path / "fold.html"
    config = ReportConfig(overlay=OverlayConfig(height=120))
    write_report(tracked, request.getfixturevalue(recording), path, config=config)
    with chromium.opened(chromium.find_chromium(), path, tmp_path / "profile") as page:
        page.wait_for("document.querySelector('video').readyState >= 2")
        assert page.ask("document.querySelector('video').error") is None
        page.ask("document.querySelector('iframe').scrollIntoView({block: 'center'})")
        page.wait_for(f"!!({SCENE} && {SCENE}.querySelector('canvas'))")
        page.wait_for(f"!!{SCENE}.querySelector('input')")
        before = page.ask(CLOCK)
        page.wait_for(f"{CLOCK} !== {before}")
        cursor = "document.querySelector('.cursor').getAttribute('x1')"
        start = page.ask(cursor)
        page.ask("void (document.querySelector('video').currentTime = 0.45)")
        page.wait_for(f"{cursor} !== '{start}'")
        assert page.ask("document.querySelector('.now').textContent").strip()
        assert any(cloth_pixels(page) > 2000 for _ in range(20))
        own = ("file:", "data:", "blob:", "about:")
        outside = [url for url in page.requests() if not url.startswith(own)]
        assert outside == []
        assert page.complaints() == []
