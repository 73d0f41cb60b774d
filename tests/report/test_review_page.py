"""The page of a trajectory as a reviewer uses it: keys, time bar, views, pointer, files, widths."""

import importlib.util
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.mesh_file import read_mesh
from clothtrack.recordings.recording import Frame
from clothtrack.report.overlay import OverlayConfig
from clothtrack.report.page import ReportConfig, write_report
from clothtrack.tracking.tracked_trajectory import StepRecords

_spec = importlib.util.spec_from_file_location("chromium", Path(__file__).with_name("chromium.py"))
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)
MOVE_BAR, scene_picture = chromium.MOVE_BAR, chromium.scene_picture

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine"),
]

READY = "document.body.dataset.ready === 'yes'"
TOLD = "document.querySelector('#told').textContent"
VERDICTS = "[...document.querySelectorAll('.verdict')].map((one) => one.textContent)"
CAMERA = "document.querySelector('canvas').dataset.camera"


@pytest.fixture
def opened(tracked, two_cameras, tmp_path):
    """Opens the report of the folded sheet, seen by the camera above it."""

    def open_report(recording=None, shown=tracked, **options):
        path = tmp_path / "fold.html"
        config = ReportConfig(overlay=OverlayConfig(height=120, cameras=1, closest=1.0))
        write_report(shown, recording or two_cameras, path, config=config, **options)
        return chromium.opened(chromium.find_chromium(), path, tmp_path / "profile")

    return open_report


def press(page, *keys):
    codes = {" ": "Space"}
    for key in keys:
        page.press(key, codes.get(key, key if len(key) > 1 else f"Key{key.upper()}"))


def click(page, selector):
    """Press the left button of a mouse over the middle of an element."""
    one = f"document.querySelector({json.dumps(selector)})"
    page.ask(f"void {one}.scrollIntoView({{block: 'center'}})")
    x, y = page.ask(
        f"(() => {{ const b = {one}.getBoundingClientRect();"
        "return [b.left + b.width / 2, b.top + b.height / 2]; })()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1
        )


def blueness(picture):
    """Pixels in the hue of the outer side."""
    return picture[..., 2] - picture[..., 0] > 50


@pytest.mark.parametrize(
    "focused", ["[name=mode]", "[name=gap]", "#undo", "[name=cloud]", "canvas"]
)
def test_keys_work_whatever_has_the_focus(opened, focused):
    with opened() as page:
        page.wait_for(READY)
        before = page.ask("document.querySelector('[name=mode]').value")
        page.ask(f"document.querySelector('{focused}').focus()")
        press(page, "ArrowRight", "ArrowRight", "ArrowLeft")
        page.wait_for(f"{TOLD}.startsWith('frame 1,')")
        page.ask("window.plays = 0; document.querySelector('video').onplay = () => { plays += 1; }")
        press(page, " ")
        page.wait_for("plays === 1")
        page.wait_for(
            "document.querySelector('video').ended || document.querySelector('video').paused"
        )
        press(page, "ArrowUp", "a", "r", "u")
        page.wait_for(f"{VERDICTS}.join() === 'accepted,open'")
        assert page.ask("document.querySelector('[name=mode]').value") == before
        assert page.ask("document.querySelector('[name=cloud]').checked")
        assert page.complaints() == []


def test_from_the_camera_the_scene_lies_where_the_picture_has_it(opened):
    with opened() as page:
        page.wait_for(READY)
        for name in ("cloud", "path"):
            page.ask(f"void document.querySelector('[name={name}]').click()")
        press(page, "c", "v")
        page.wait_for(f"{CAMERA} === '0'")
        page.wait_for("document.querySelector('video').readyState >= 2")
        raw, scene = scene_picture(page, ".film .picture"), scene_picture(page)
        filmed = raw[..., 0] - raw[..., 2] > 60
        drawn = blueness(scene) | (scene[..., 0] - scene[..., 2] > 60)
        places = []
        for mask in (filmed, drawn):
            rows, columns = np.nonzero(mask)
            scale = min(mask.shape[1] / 160, mask.shape[0] / 120)
            middle = (np.array(mask.shape) - 1) / 2
            places.append(
                [
                    (side - m) / scale
                    for side, m in (
                        (rows.min(), middle[0]),
                        (rows.max(), middle[0]),
                        (columns.min(), middle[1]),
                        (columns.max(), middle[1]),
                    )
                ]
            )
        np.testing.assert_allclose(places[1], places[0], atol=2.0)  # of 160 x 120 pixels
        page.ask("document.querySelector('canvas').focus()")
        page.press("ArrowLeft", "ArrowLeft", modifiers=8)
        page.wait_for(f"{CAMERA} === 'free' && document.querySelector('[name=view]').value === ''")


def test_the_mesh_of_the_shown_frame_is_saved(opened, tracked, tmp_path):
    with opened() as page:
        page.wait_for(READY)
        page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
        page.ask(MOVE_BAR % (3, 3))
        for button in ("#ply", "#shot"):
            page.ask(f"void document.querySelector('{button}').click()")
        for suffix in ("ply", "png"):
            for _ in range(100):
                if any(one.stat().st_size for one in tmp_path.glob(f"*_frame3.{suffix}")):
                    break
                time.sleep(0.1)
        (saved,) = tmp_path.glob("*_frame3.ply")
        mesh = read_mesh(saved)
        np.testing.assert_allclose(mesh.vertices, tracked.positions[3], atol=4e-5)
        np.testing.assert_array_equal(mesh.faces, tracked.mesh.faces)
        (picture,) = tmp_path.glob("*_frame3.png")
        assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("width", [390, 1024, 1440, 2560])
def test_every_width_shows_all_without_scrolling_sideways(opened, width):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    with opened() as page:
        page.wait_for(READY)
        page.call("Emulation.setDeviceMetricsOverride", **size)
        page.wait_for(f"innerWidth === {width}")
        assert page.ask("document.documentElement.scrollWidth") <= width
        assert (
            page.ask("document.querySelector('.stage').getBoundingClientRect().width") > 0.8 * width
        )
        assert blueness(scene_picture(page)).mean() > 0.03
        assert scene_picture(page, ".film .picture").std() > 10


def test_180_frames_of_a_full_sized_cloth_are_under_5_mb(two_cameras, tracked, tmp_path, rng):
    count, side = 180, 38
    u = np.linspace(-0.15, 0.15, side)
    x, y = np.meshgrid(u, u)
    first = np.arange(side * side).reshape(side, side)[:-1, :-1].ravel()
    faces = np.concatenate([
        np.stack([first, first + 1, first + side], axis=1),
        np.stack([first + 1, first + side + 1, first + side], axis=1),
    ])  # fmt: skip
    phase = np.linspace(0, 6, count)[:, None, None]
    z = 0.02 + 0.01 * np.sin(25 * x + phase) + rng.normal(0, 2e-4, (count, side, side))
    positions = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y, z.shape), z], axis=-1)
    positions = positions.reshape(count, -1, 3).astype(np.float32)
    frames = tuple(
        Frame(
            k,
            k / 20,
            **{
                kind: getattr(two_cameras.frames[k % 6], kind)
                for kind in ("color", "depth", "mask")
            },
        )
        for k in range(count)
    )
    waving = replace(
        tracked, mesh=ClothMesh(positions[0].astype(float), faces), positions=positions,
        frames=np.arange(count, dtype=np.int32), time_s=np.arange(count) / 20,
        visible=np.ones(positions.shape[:2], bool), steps=StepRecords.empty(count), actions=(),
    )  # fmt: skip
    config = ReportConfig(overlay=OverlayConfig(cameras=1))
    recording = replace(two_cameras, frames=frames, actions=())
    path = write_report(waving, recording, tmp_path / "long.html", config=config)
    assert path.stat().st_size < 5e6
    with chromium.opened(chromium.find_chromium(), path, tmp_path / "profile") as page:
        page.wait_for(READY)
        page.ask(MOVE_BAR % (count - 1, count - 1))
        assert page.ask(TOLD).startswith(f"frame {count - 1},")
        assert page.complaints() == []
        own = ("file:", "data:", "blob:", "about:")
        assert [url for url in page.requests() if not url.startswith(own)] == []
