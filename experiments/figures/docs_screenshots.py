"""Make the screenshots of the documents by opening pages in a headless Chromium.

    clothtrack simulate out/world --garment tshirt --actions 2
    clothtrack track out/world/recordings/* --output out/tracked
    python experiments docs_screenshots --tracked out/tracked/tshirt_0000.zarr \
        --recordings out/world/recordings --truth out/world/truth

writes docs/images/report_*.png. With a film it runs the commands of docs/own_recording.md or
docs/bare_hand.md one after the other, and saves a picture of each step:

    python experiments picker_from_pictures --smoke --out out/tip
    python experiments docs_screenshots --walk own_recording --film out/tip/recordings/towel_0100
    python experiments bare_hand --films 1 --out out/hand
    python experiments docs_screenshots --walk bare_hand --film out/hand/recordings/towel_0300

Only color and depth of the film are used, as a folder that another program might have written. The
clicks on a bare hand are made with a mouse, where a person would see the fingers close and open.
Chromium must be on the path; it draws without a graphics card.
"""

import argparse
import importlib.util
import json
import queue
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import cv2
import numpy as np
from shared.figures import say, write_png
from tables.bare_hand import holds

import clothtrack as ct
from clothtrack.cli import command_line as cli
from clothtrack.evaluation.label_review import LabelReview
from clothtrack.geometry.devices import quiet_warp
from clothtrack.report.live import Decisions, live_page
from clothtrack_capture import find_picker

WIDTH_PX = 1000
BROWSER = Path(__file__).parents[2] / "tests" / "report" / "chromium.py"
PATIENCE_S = 60.0
"""A page is served within this time [s]."""

LATE_FRAMES = 2
"""A person stops the film a little after the fingers have closed, and after they have opened."""

READY = "document.body.dataset.ready === 'yes'"
TURN = """(() => {
  const set = (name, value, event) => {
    const one = document.querySelector(`[name=${name}]`);
    one.value = value;
    one.dispatchEvent(new Event(event));
  };
  set('mode', '%s', 'change');
  set('gap', %s, 'input');
  set('opacity', %s, 'input');
  const bar = document.querySelector('#time');
  bar.value = bar.max;
  bar.dispatchEvent(new Event('input'));
  document.querySelector('.verdicts').scrollIntoView();
})()"""

Image = Callable[[str], Path]


@contextmanager
def opened(where: Path | str) -> Iterator[Any]:
    """Yield a page in a new browser, controlled as the tests do."""
    spec = importlib.util.spec_from_file_location("chromium", BROWSER)
    assert spec is not None
    assert spec.loader is not None
    chromium = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(chromium)
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        chromium.opened(chromium.find_chromium(), where, Path(profile)) as page,
    ):
        yield page


def save(page: Any, image: Path) -> None:
    """Save a screenshot at the size of a document."""
    shown = cv2.imdecode(np.frombuffer(page.picture(), np.uint8), 1)[..., ::-1]
    save_small(np.ascontiguousarray(shown), image)


def save_small(picture: np.ndarray, image: Path) -> None:
    """Save a picture at the width of a document."""
    height = round(WIDTH_PX * picture.shape[0] / picture.shape[1])
    write_png(image, cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA))
    say(f"{image}: {image.stat().st_size / 1e3:.0f} kB\n")


def turned(page: Any, mode: str, gap: float = 0, opacity: float = 1) -> None:
    """Show the last frame of a report in a mode."""
    page.wait_for(READY)
    page.ask(TURN % (mode, gap, opacity))
    page.wait_for("!document.querySelector('video').seeking")


def shoot_report(run: ct.Run, truth: Path, file: Path, image: Image) -> None:
    """Save the offline report, and the served page at the last label, rejected."""
    page_file = ct.write_report(run, file, truth=truth)
    with opened(page_file) as page:
        modes = (
            ("sides", "sides", 0, 1),
            ("layers", "visible", 0.03, 0.7),
            ("truth", "truth", 0, 1),
        )
        for name, *look in modes:
            turned(page, *look)
            time.sleep(2)
            save(page, image(name))
        page.ask("void document.querySelector('.charts').scrollIntoView()")
        time.sleep(1)
        save(page, image("curves"))
    addresses: list[str] = []
    decisions = Decisions(LabelReview.blank(run), file.with_name(f"{run.name}.review.json"))
    with live_page(run.name, decisions=decisions, opened=addresses.append) as live:
        live.show(page_file)
        with opened(addresses[0]) as page:
            page.wait_for(READY)
            for key, code in (("a", "KeyA"), ("r", "KeyR")):
                page.press(key, code)
            page.wait_for("document.querySelector('[data-verdict=rejected]') !== null")
            page.ask("void scrollTo(0, 0)")
            time.sleep(3)
            save(page, image("live"))


def walk(film: ct.Recording, place: Path, image: Image, *, by_hand: bool) -> None:
    """Go from a folder of pictures to a report, with clicks or with a colored tip."""
    source, towel, masks = strip(film, place / "film"), place / "out" / "towel", place / "masks.png"
    color = () if by_hand else ("--cloth-color", str(film.cloth.color))
    run("import", source, towel, "--cloth", "towel", *color)
    run("calibrate-camera", towel)
    run("segment", towel, "--click", 320, 240, "--sheet", masks)
    if by_hand:
        clicked_in_browser(film, towel, image("page"))
    else:
        save_small(ct.read_color(masks), image("masks"))
        run("find-picker", towel, "--tip-color", "pink")
    run("inspect", towel)
    run("track", towel, "--output", place / "tracked")
    tracked, report = place / "tracked" / "towel.zarr", place / "towel.html"
    run("view", tracked, "--recordings", towel, "--html", report)
    with opened(report) as page:
        turned(page, "sides")
        save(page, image("report"))


def run(*words: object) -> None:
    """Run one command of the documentation, and say how long it takes; stop if it fails."""
    say(f"clothtrack {' '.join(map(str, words))}\n")
    began, worked = time.monotonic(), time.process_time()
    if done := cli.main([str(word) for word in words]):
        raise SystemExit(done)
    say(f"{time.monotonic() - began:.0f} s, {time.process_time() - worked:.0f} s of work\n\n")


def strip(film: ct.Recording, folder: Path) -> Path:
    """Return color and depth of a film as a folder in Open3D's style, and nothing else."""
    camera = film.cameras[0]
    for kind in ("depth", "color"):
        (folder / kind).mkdir(parents=True)
        for frame in film.frames:
            name = folder / kind / f"{frame.index:06d}.png"
            shutil.copy(getattr(frame, kind)[camera.name], name)
    matrix = [camera.fx, 0, 0, 0, camera.fy, 0, camera.cx, camera.cy, 1]
    content = {"width": camera.width, "height": camera.height, "intrinsic_matrix": matrix,
               "fps": 1 / film.frames[1].time_s,
               "depth_scale": 1 / film.depth_units_m[camera.name]}  # fmt: skip
    (folder / "intrinsic.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


def clicked_in_browser(film: ct.Recording, towel: Path, image: Path) -> None:
    """Use the page of `find-picker --by-hand` with a mouse and save a picture of it."""
    camera, path = film.cameras[0], film.picker_paths["gripper"]
    addresses: queue.Queue[str] = queue.Queue()
    server = threading.Thread(
        target=find_picker, args=(towel,), kwargs={"by_hand": True, "opened": addresses.put}
    )
    server.start()
    with opened(addresses.get(timeout=PATIENCE_S)) as page:
        page.wait_for("!!document.querySelector('#list li') && wanted === null")
        for frame in np.concatenate(holds(path)).tolist():
            (pixel,), _ = camera.project(path.positions[frame][None])
            mouse_click(page, frame + LATE_FRAMES, pixel.round() / camera.width)
        pick, release = holds(path)[-1]
        page.ask(f"show({(pick + release) // 2})")
        page.wait_for("wanted === null")
        save(page, image)
        page.press("s", "KeyS")
        page.wait_for("saved")
    server.join()


def mouse_click(page: Any, frame: int, place: np.ndarray) -> None:
    """Go to a frame and click on a place of it, in parts of its width."""
    page.ask(f"show({frame})")
    page.wait_for("wanted === null")
    left, top, shown = page.ask(
        "(() => { const b = document.querySelector('#frame').getBoundingClientRect();"
        "return [b.left, b.top, b.width]; })()"
    )
    spot = {"x": left + place[0] * shown, "y": top + place[1] * shown}
    page.call("Input.dispatchMouseEvent", type="mouseMoved", **spot)
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, **spot, button="left", buttons=1, clickCount=1
        )
    page.wait_for("!busy")


def main() -> None:
    """Open every page and save screenshots."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tracked", type=Path, help="of the report")
    parser.add_argument("--recordings", type=Path, help="of the report")
    parser.add_argument("--truth", type=Path, help="of the report")
    parser.add_argument("--walk", choices=("own_recording", "bare_hand"), help="a page's commands")
    parser.add_argument("--film", type=Path, help="of the walk")
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    if options.walk is None and not (options.tracked and options.recordings and options.truth):
        parser.error("give --tracked, --recordings and --truth, or --walk and --film")
    quiet_warp()
    page = options.walk or "report"

    def image(name: str) -> Path:
        return options.images / f"{page}_{name}.png"

    with tempfile.TemporaryDirectory() as folder:
        if options.walk is None:
            tracked = ct.load(options.tracked, options.recordings)
            shoot_report(tracked, options.truth, Path(folder) / "report.html", image)
        else:
            film = ct.read_recording(options.film)
            walk(film, Path(folder), image, by_hand=page == "bare_hand")


if __name__ == "__main__":
    main()
