"""Make the pictures of docs/own_recording.md by running its commands one after the other.

    python experiments picker_from_pictures --smoke --out out/tip
    .venv/bin/python experiments own_recording_pictures --film out/tip/recordings/towel_0100

Only color and depth of the recording are used, as a folder that another program might have written.
The camera pose, the cloth's mask and the picker are found again. Writes
docs/images/own_recording_*.png; Chromium must be on the path.
"""

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import _path  # noqa: F401
import cv2
import numpy as np
from jaxtyping import UInt8
from shared.figures import say, write_png

from clothtrack.cli import command_line as cli
from clothtrack.recordings import Recording, read_color, read_depth, read_recording
from clothtrack.report.palette import HIDDEN, OUTSIDE, PICKER_CLOSED, rgb255
from figures.docs_screenshots import READY, TURN, WIDTH_PX, opened, save

SQUARE_M = 0.05
NEAR_M = 0.003


def main() -> None:
    """Run the commands and save a picture of each step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--film", type=Path, required=True, help="with a pink tip on the tool")
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    options = parser.parse_args()

    def image(name: str) -> Path:
        return options.images / f"own_recording_{name}.png"

    with tempfile.TemporaryDirectory() as place:
        walk(read_recording(options.film), Path(place), image)


def walk(film: Recording, place: Path, image: Callable[[str], Path]) -> None:
    """Go from a folder of pictures to a report."""
    source, towel = strip(film, place / "film"), place / "out" / "towel"
    run("import", source, towel, "--cloth", "towel", "--cloth-color", str(film.cloth.color))
    run("calibrate-camera", towel)
    shown = table_picture(read_recording(towel))
    write_png(image("table"), shown)
    sheet = place / "masks.png"
    run("segment", towel, "--click", 320, 240, "--sheet", sheet)
    write_png(image("masks"), smaller(read_color(sheet)))
    run("find-picker", towel, "--tip-color", "pink")
    run("inspect", towel)
    run("track", towel, "--output", place / "tracked")
    report = place / "towel.html"
    tracked = place / "tracked" / "towel.zarr"
    run("view", tracked, "--recordings", towel, "--html", report)
    with opened(report) as page:
        page.wait_for(READY)
        page.ask(TURN % ("sides", 0, 1))
        page.wait_for("!document.querySelector('video').seeking")
        save(page, image("report"))


def run(*words: object) -> None:
    """Run one command of the documentation; stop if it fails."""
    say(f"clothtrack {' '.join(map(str, words))}\n")
    done = cli.main([str(word) for word in words])
    if done:
        raise SystemExit(done)


def smaller(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Return the picture at the width of a document."""
    height = round(WIDTH_PX * picture.shape[0] / picture.shape[1])
    return cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)


def strip(film: Recording, folder: Path) -> Path:
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


def table_picture(recording: Recording) -> UInt8[np.ndarray, "height width 3"]:
    """Return the first frame with the table's plane tinted, and the world's axes and squares."""
    camera, frame = recording.cameras[0], recording.frames[0]
    picture = read_color(frame.color[camera.name])
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    rows, columns = np.nonzero(depth)
    ahead = depth[rows, columns]
    points = np.stack([
        (columns - camera.cx) / camera.fx * ahead, (rows - camera.cy) / camera.fy * ahead, ahead
    ], 1)  # fmt: skip
    pose = camera.world_from_camera
    flat = np.abs(points @ pose[2, :3] + pose[2, 3]) < NEAR_M
    tint = np.array(rgb255(OUTSIDE))
    chosen = rows[flat], columns[flat]
    picture[chosen] = (0.45 * picture[chosen] + 0.55 * tint).astype(np.uint8)
    reach = np.arange(-4, 5) * SQUARE_M
    lines = [((x, reach[0]), (x, reach[-1])) for x in reach]
    lines += [((reach[0], y), (reach[-1], y)) for y in reach]
    for ends in lines:
        cv2.line(picture, *pixels(recording, ends), (255, 255, 255), 1, cv2.LINE_AA)
    for end, color in (((0.1, 0), rgb255(PICKER_CLOSED)), ((0, 0.1), rgb255(HIDDEN))):
        cv2.arrowedLine(picture, *pixels(recording, ((0, 0), end)), color, 3, cv2.LINE_AA)
    return picture


def pixels(
    recording: Recording, ends: tuple[tuple[float, float], tuple[float, float]]
) -> list[tuple[int, int]]:
    """Return where two points of the table are in the picture."""
    camera = recording.cameras[0]
    world = np.array([(*end, 0.0) for end in ends])
    pose = camera.world_from_camera
    seen = (world - pose[:3, 3]) @ pose[:3, :3]
    spots = seen[:, :2] / seen[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    return [(round(float(x)), round(float(y))) for x, y in spots]


if __name__ == "__main__":
    main()
