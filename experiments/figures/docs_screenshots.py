"""Make the screenshots of docs/report.md by opening each page in a headless Chromium.

    clothtrack simulate out/world --garment tshirt --actions 2
    clothtrack track out/world/recordings/* --output out/tracked
    .venv/bin/python experiments docs_screenshots --tracked out/tracked/tshirt_0000.zarr \
        --recordings out/world/recordings --truth out/world/truth

writes docs/images/report_*.png. Chromium must be on the path; it draws without a graphics card.
"""

import argparse
import importlib.util
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import _path  # noqa: F401
import cv2
import numpy as np
from shared.figures import say, write_png

import clothtrack as ct
from clothtrack.evaluation import LabelReview
from clothtrack.geometry import quiet_warp
from clothtrack.report.live import Decisions, live_page

WIDTH_PX = 1000
BROWSER = Path(__file__).parents[2] / "tests" / "report" / "chromium.py"
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


def browser() -> ModuleType:
    """Return the module of the tests that controls Chromium."""
    spec = importlib.util.spec_from_file_location("chromium", BROWSER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def opened(where: Path | str) -> Iterator[Any]:
    """Yield a page in a new browser."""
    chromium = browser()
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        chromium.opened(chromium.find_chromium(), where, Path(profile)) as page,
    ):
        yield page


def save(page: Any, image: Path) -> None:
    """Save a screenshot at the size of a document."""
    shown = cv2.imdecode(np.frombuffer(page.picture(), np.uint8), 1)[..., ::-1]
    height = round(WIDTH_PX * shown.shape[0] / shown.shape[1])
    small = cv2.resize(shown, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    write_png(image, np.ascontiguousarray(small))
    say(f"{image}: {image.stat().st_size / 1e3:.0f} kB\n")


def shoot_report(file: Path, image: Callable[[str], Path]) -> None:
    """Save the offline report: its first view, separated layers, and the true error."""
    with opened(file) as page:
        page.wait_for(READY)
        for name, mode, gap, opacity in (
            ("sides", "sides", 0, 1),
            ("layers", "visible", 0.03, 0.7),
            ("truth", "truth", 0, 1),
        ):
            page.ask(TURN % (mode, gap, opacity))
            page.wait_for("!document.querySelector('video').seeking")
            time.sleep(2)
            save(page, image(name))
        page.ask("void document.querySelector('.charts').scrollIntoView()")
        time.sleep(1)
        save(page, image("curves"))


def shoot_live(run: ct.Run, file: Path, image: Callable[[str], Path]) -> None:
    """Save the served page at the last label, rejected."""
    review = file.with_name(f"{run.name}.review.json")
    addresses: list[str] = []
    decisions = Decisions(LabelReview.blank(run), review)
    with live_page(run.name, decisions=decisions, opened=addresses.append) as live:
        live.show(file)
        with opened(addresses[0]) as page:
            page.wait_for(READY)
            for key, code in (("a", "KeyA"), ("r", "KeyR")):
                page.press(key, code)
            page.wait_for("document.querySelector('[data-verdict=rejected]') !== null")
            page.ask("void scrollTo(0, 0)")
            time.sleep(3)
            save(page, image("live"))


def main() -> None:
    """Open every page and save screenshots."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tracked", type=Path, required=True)
    parser.add_argument("--recordings", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    arguments = parser.parse_args()
    quiet_warp()
    run = ct.load(arguments.tracked, arguments.recordings)

    def image(name: str) -> Path:
        return arguments.images / f"report_{name}.png"

    with tempfile.TemporaryDirectory() as folder:
        page = ct.write_report(run, Path(folder) / "report.html", truth=arguments.truth)
        shoot_report(page, image)
        shoot_live(run, page, image)


if __name__ == "__main__":
    main()
