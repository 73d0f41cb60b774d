"""Make the pictures of docs/bare_hand.md by running its commands and clicking in a browser.

    python experiments bare_hand --films 1 --out out/bare_hand
    .venv/bin/python experiments bare_hand_pictures --film out/bare_hand/recordings/towel_0300

Only color and depth of the recording are used, as a folder that another program might have written.
The clicks are made with a mouse in Chromium, at the pixels where a person would see the fingers
close and open. The time of each command is printed. Writes docs/images/bare_hand_*.png; Chromium
must be on the path, and the extra [experiments] installed.
"""

import argparse
import json
import queue
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from shared.figures import plot_style, say
from tables.bare_hand import holds

import clothtrack as ct
from clothtrack.report.palette import HIDDEN, INK, OUTSIDE
from clothtrack_capture import find_picker
from clothtrack_capture.carried_path import highest_cloth
from clothtrack_capture.clicked_picking import ClickedPicking
from clothtrack_capture.cloth_views import Click
from figures.docs_screenshots import READY, TURN, opened, save
from figures.own_recording_pictures import run, strip

PATIENCE_S = 60.0
"""A page is served within this time [s]."""

LATE_FRAMES = 2
"""A person stops the film a little after the fingers have closed, and after they have opened."""


def main() -> None:
    """Run the commands, click, and save a picture of each step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--film", type=Path, required=True, help="a film of `bare_hand`")
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    options = parser.parse_args()

    def image(name: str) -> Path:
        return options.images / f"bare_hand_{name}.png"

    with tempfile.TemporaryDirectory() as place:
        walk(ct.read_recording(options.film), Path(place), image)


def walk(film: ct.Recording, place: Path, image: Callable[[str], Path]) -> None:
    """Go from a folder of pictures to a report."""
    source, towel = strip(film, place / "film"), place / "out" / "towel"
    timed("import", source, towel, "--cloth", "towel")
    timed("calibrate-camera", towel)
    timed("segment", towel, "--click", 320, 240, "--sheet", place / "masks.png")
    clicked_in_browser(film, towel, image("page"))
    draw_heights(film, ct.read_recording(towel), image("heights"))
    timed("inspect", towel)
    timed("track", towel, "--output", place / "tracked")
    tracked, report = place / "tracked" / "towel.zarr", place / "towel.html"
    timed("evaluate", tracked, "--recordings", towel)
    timed("view", tracked, "--recordings", towel, "--html", report)
    with opened(report) as page:
        page.wait_for(READY)
        page.ask(TURN % ("sides", 0, 1))
        page.wait_for("!document.querySelector('video').seeking")
        save(page, image("report"))


def timed(*words: object) -> None:
    """Run one command of the documentation, and print its time."""
    began, worked = time.monotonic(), time.process_time()
    run(*words)
    say(f"{time.monotonic() - began:.0f} s, {time.process_time() - worked:.0f} s of work\n\n")


def clicked_in_browser(film: ct.Recording, towel: Path, image: Path) -> None:
    """Use the page of `find-picker --by-hand` with a mouse and save pictures of it."""
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
            column, row = pixel.round().astype(int).tolist()
            mouse_click(page, Click(frame + LATE_FRAMES, column, row), camera.width)
        pick, release = holds(path)[-1]
        page.ask(f"show({(pick + release) // 2})")
        page.wait_for("wanted === null")
        save(page, image)
        page.press("s", "KeyS")
        page.wait_for("saved")
    server.join()


def mouse_click(page: Any, click: Click, width: int) -> None:
    """Go to a frame and click on one of its pixels."""
    page.ask(f"show({click.frame})")
    page.wait_for("wanted === null")
    left, top, shown = page.ask(
        "(() => { const b = document.querySelector('#frame').getBoundingClientRect();"
        "return [b.left, b.top, b.width]; })()"
    )
    scale = shown / width
    spot = {"x": left + (click.column + 0.5) * scale, "y": top + (click.row + 0.5) * scale}
    page.call("Input.dispatchMouseEvent", type="mouseMoved", **spot)
    for kind in ("mousePressed", "mouseReleased"):
        page.call(
            "Input.dispatchMouseEvent", type=kind, **spot, button="left", buttons=1, clickCount=1
        )
    page.wait_for("!busy")


def draw_heights(film: ct.Recording, towel: ct.Recording, image: Path) -> None:
    """Draw the highest cloth near the first path, the arc fitted to it, and the true path."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    picking = ClickedPicking(towel, towel.cameras[0])
    first = json.loads((towel.folder / "recording.json").read_text())["provenance"]["picker_found"]
    for end in ("pick", "place"):
        picking.add(Click(*first["actions"][0][end]))
    table, times, action = picking.views.table, picking.times, picking.actions()[0]
    pick, release = holds(film.picker_paths["gripper"])[0]
    frames = np.arange(max(0, pick - 8), release + 9)
    highest = []
    for index in frames.tolist():
        view = picking.views.of(index)
        inner = view.points[view.inner]
        ends = action.path.pick, action.path.place
        highest.append(highest_cloth(inner, table.heights(inner), *ends, table.normal)[0])
    arc = table.heights(action.path.positions_at(times[frames]))
    held = np.arange(pick, release + 1)
    true = film.picker_paths["gripper"].positions[held, 2]
    with mpl.rc_context(plot_style(title_size=10)):
        figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
        axes.plot(times[held], 1e3 * true, color=INK, lw=1, ls="--", label="true path of the tip")
        axes.plot(times[frames], 1e3 * arc, color=HIDDEN, lw=2, label="path written")
        axes.plot(
            times[frames], 1e3 * np.array(highest), "o", ms=4, color=OUTSIDE,
            label="highest cloth in view",
        )  # fmt: skip
        for click, word in ((action.pick, "pick"), (action.place, "place")):
            at = times[click.frame]
            axes.axvline(at, color=INK, lw=0.6, alpha=0.5)
            axes.annotate(f"clicked {word}", (at, 96), ha="center", fontsize=8)
        axes.set(xlabel="time [s]", ylabel="height over the table [mm]", ylim=(-3, 104))
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.savefig(image, dpi=140)
        plt.close(figure)
    say(f"{image}: {image.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
