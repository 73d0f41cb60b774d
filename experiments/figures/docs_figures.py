"""Make the figures of the documents: the picture, the tracked mesh over it, and the mesh alone.

    make demo
    .venv/bin/python experiments docs_figures --tracked out/demo/fold_the_tshirt.zarr

writes demo.png; another recording with `--recording`, another file with `--image`.
"""

import argparse
import tempfile
from pathlib import Path

import _path  # noqa: F401
import cv2
from shared.figures import say, write_png

from clothtrack.geometry import quiet_warp
from clothtrack.recordings import read_recording, shipped_recording
from clothtrack.report import Overlay, OverlayConfig, write_contact_sheet
from clothtrack.tracking import TrackedTrajectory

ROWS = 3
WIDTH_PX = 800


def draw(tracked: Path, recording: Path, image: Path) -> Path:
    """Draw a tracked trajectory over its recording, small enough for a README."""
    overlay = Overlay(
        TrackedTrajectory.load(tracked),
        read_recording(recording),
        config=OverlayConfig(height=240),
    )
    with tempfile.TemporaryDirectory() as folder:
        sheet = cv2.imread(str(write_contact_sheet(overlay, Path(folder) / "s.png", rows=ROWS)))
    height = round(WIDTH_PX * sheet.shape[0] / sheet.shape[1])
    small = cv2.resize(sheet, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    write_png(image, cv2.cvtColor(small, cv2.COLOR_BGR2RGB))
    return image


def main() -> None:
    """Draw the figure and say how large it is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tracked", type=Path, required=True)
    parser.add_argument("--recording", type=Path, default=shipped_recording())
    parser.add_argument("--image", type=Path, default=Path("demo.png"))
    arguments = parser.parse_args()
    quiet_warp()
    image = draw(arguments.tracked, arguments.recording, arguments.image)
    say(f"{image}: {image.stat().st_size / 1e3:.0f} kB\n")


if __name__ == "__main__":
    main()
