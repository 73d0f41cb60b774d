"""Pages of a recording, of a mesh and of a folder, as the command writes and a person meets them.

Nothing here waits for a time or measures one: a slow machine is only slow.
"""

import importlib.util
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.recordings.mesh_file import write_mesh
from clothtrack.recordings.store import write_recording
from clothtrack.report.palette import TABLE, rgb255

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)
MOVE_BAR, scene_picture = chromium.MOVE_BAR, chromium.scene_picture

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine"),
]

READY = "document.body?.dataset.ready === 'yes'"
STEP = "document.querySelector('canvas').dataset.step"
TOLD = "document.querySelector('#told').textContent"
SHIFT = 8
PHONE_PX = 420
CUT_OFF = f"""[...document.querySelectorAll('body *')].filter((one) => {{
  const box = one.getBoundingClientRect();
  return box.width > 0 && box.right > {PHONE_PX} + 1 && !one.closest('pre, svg, details');
}}).map((one) => one.outerHTML.slice(0, 80))"""
"""What a narrow screen cannot show, but for what can be scrolled by itself."""


@contextmanager
def viewed(page_file, profile, *words):
    """The page that `clothtrack view` writes, in a browser that must not complain."""
    assert cli.main(["view", *map(str, words), "--html", str(page_file)]) == 0
    with chromium.opened(chromium.find_chromium(), page_file, profile) as page:
        yield page
        assert page.complaints() == []
        own = ("file:", "data:", "blob:", "about:")
        assert [url for url in page.requests() if not url.startswith(own)] == []


def difference(one, other):
    """Mean over the pixels of the largest difference of a channel, 0 to 255, but for the rim.

    There is the ring around what has the keys.
    """
    return np.abs(one - other)[8:-8, 8:-8].max(axis=2).mean()


def make_narrow(page):
    """Show the page on a phone held upright."""
    size = {"width": PHONE_PX, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    page.call("Emulation.setDeviceMetricsOverride", **size)


@pytest.fixture(scope="module")
def stored(two_cameras, tmp_path_factory):
    """The recording of two cameras as it lies on a disk."""
    folder = tmp_path_factory.mktemp("recordings") / "fold"
    write_recording(two_cameras, folder)
    return folder


def test_a_recording_plays_and_follows_bar_and_keys(stored, tmp_path):
    with viewed(tmp_path / "recording.html", tmp_path / "profile", stored) as page:
        page.wait_for(READY)
        page.wait_for("document.querySelector('video').readyState >= 2")
        page.wait_for(f"{STEP} === '0'")
        first = scene_picture(page)
        assert (
            first[..., 0] - first[..., 1] > 60
        ).sum() > 500  # red as the cloth: what was observed
        assert np.abs(np.median(first, axis=(0, 1)) - rgb255(TABLE)).max() < 20  # nothing shades it
        filmed = scene_picture(page, "video")
        assert filmed.std() > 10
        page.ask(MOVE_BAR % (5, 5))
        page.wait_for("!document.querySelector('video').seeking")
        assert page.ask(TOLD) == "frame 5, 0.50 s"
        assert difference(scene_picture(page), first) > 1
        assert difference(scene_picture(page, "video"), filmed) > 1
        page.press("ArrowLeft", "ArrowLeft")
        page.wait_for(f"{STEP} === '4'")
        assert page.ask(TOLD) == "frame 4, 0.40 s"


def test_a_mesh_is_turned_and_its_layers_lifted_by_keys(tracked, tmp_path):
    mesh = tmp_path / "folded.ply"
    write_mesh(replace(tracked.mesh, vertices=tracked.positions[5].astype(np.float64)), mesh)
    with viewed(tmp_path / "mesh.html", tmp_path / "profile", mesh) as page:
        page.wait_for(READY)
        page.wait_for(f"{STEP} === '0'")
        first = scene_picture(page)
        blue = first[..., 2] - first[..., 0] > 50
        assert 2000 < blue.sum() < 0.8 * blue.size
        assert page.ask("document.querySelector('#time')") is None
        page.ask("document.querySelector('canvas').focus()")
        for _ in range(4):
            page.press("ArrowRight", "ArrowRight", modifiers=SHIFT)
        turned = scene_picture(page)
        assert difference(turned, first) > 1
        page.press("0", "Digit0")
        assert difference(scene_picture(page), first) < 1
        page.ask("document.querySelector('[name=gap]').focus()")
        for _ in range(20):
            page.press("ArrowRight", "ArrowRight")
        assert float(page.ask("document.querySelector('[name=gap]').value")) == pytest.approx(0.02)
        assert difference(scene_picture(page), first) > 1


def test_the_index_of_a_folder_leads_to_its_reports_by_key(tracked, stored, tmp_path):
    named = replace(tracked, name="fold")
    named.save(tmp_path / "tracked" / "fold.zarr")
    (tmp_path / "tracked" / "torn.zarr").mkdir()
    words = (tmp_path / "tracked", "--recordings", stored.parent)
    with viewed(tmp_path / "index.html", tmp_path / "profile", *words) as page:
        shown = page.ask("document.body.innerText")
        assert "2 open" in shown
        assert "no report" in shown
        assert scene_picture(page, "main").std() > 5
        make_narrow(page)
        assert page.ask(CUT_OFF) == []
        page.press("Tab", "Tab")
        assert page.ask("document.activeElement.textContent") == "fold"
        page.press("Enter", "Enter")
        page.wait_for(READY)
        page.wait_for(f"{STEP} === '0'")
        first = scene_picture(page)
        assert page.ask(CUT_OFF) == []
        page.ask(MOVE_BAR % (5, 5))
        assert difference(scene_picture(page), first) > 1
