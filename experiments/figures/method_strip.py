"""Draw a strip per method: the mesh over the picture, the mesh, and its error from both sides.

    python experiments method_strip --bench OUT --rows OUT/experiments \
        --recording tshirt_0003 --image docs/images/methods.png

Several recordings are drawn below each other. Rows of several folders, for example of two commits,
are labeled with the commit that they were tracked at. The first strip is the truth. The two sides
of the cloth have different hues, so that layers pushed through each other show as patches. The view
from below, without the table, shows what the camera could not see.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import _path  # noqa: F401
import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from shared.bench_measures import Row
from shared.bench_runs import read_rows
from shared.figures import say, write_png

from clothtrack.evaluation import Truth, material_map, material_points
from clothtrack.geometry import Camera, quiet_warp
from clothtrack.recordings import Recording, read_color, read_recording
from clothtrack.report.lettering import caption, heat_legend
from clothtrack.report.palette import INK, PAPER, heat, rgb255
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.report.viewpoint import three_quarter_view

HEIGHT, WIDTH = 156, 208
GAP = 3
SOURCES = ("table1", "model_free")
FROM_BELOW = (-0.45, 0.55, -0.70)
"""Towards the light in a camera that looks up: what faces down there faces the picture's foot."""


@dataclass(frozen=True, eq=False)
class Strip:
    """One line of the picture.

    Attributes:
        vertices: the mesh [m].
        errors: distance of each vertex to its true place [m].
    """

    words: tuple[str, str]
    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    errors: Float[np.ndarray, " vertices"]


def strips(rows: Sequence[tuple[str, Path, Row]], truth: Truth, action: int) -> list[Strip]:
    """Return the truth and every row's mesh after TTO2, at the end of an action (from 1)."""
    found: dict[str, Strip] = {}
    for name, folder, row in rows:
        if row["action"] != action or row["stage"] != "after" or name in found:
            continue
        with np.load((folder / str(row["run"])).with_suffix(".npz")) as meshes:
            vertices = meshes["after"][action - 1].astype(np.float64)
            faces, canonical = meshes["faces"], meshes["canonical"].astype(np.float64)
        where = material_map(truth.canonical, truth.faces, canonical)
        points = material_points(truth.at(int(row["frame"])), truth.faces, where)
        if not found:
            still = np.zeros(len(points))
            found[""] = Strip(("the truth, on the tracker's vertices", ""), points, faces, still)
        errors = np.linalg.norm(vertices - points, axis=1)
        words = (
            f"{name}: {row['error_all_mm']:.1f} mm, hidden {row['error_hidden_mm'] or 0.0:.1f}",
            f"strain {100 * row['edge_strain']:.1f} %, {row['crossings']} crossings",
        )
        found[name] = Strip(words, vertices, faces, errors)
    return list(found.values())


def draw(
    chosen: Sequence[Strip], recording: Recording, frame: int, *, limit_mm: float
) -> UInt8[np.ndarray, "height width 3"]:
    """Return all strips stacked vertically."""
    points = chosen[0].vertices
    everything = np.concatenate([strip.vertices for strip in chosen])
    above = three_quarter_view(everything, width=WIDTH, height=HEIGHT)
    below = three_quarter_view(everything, width=WIDTH, height=HEIGHT, elevation_deg=-38.0)
    lines = []
    for number, strip in enumerate(chosen):
        colors = heat(1e3 * strip.errors, limit_mm)
        pictures = [
            _close_up(recording, frame, points, None if number == 0 else strip),
            _still(strip, above, recording),
            _still(strip, above, recording, colors),
            _still(strip, below, None, colors, light=FROM_BELOW),
        ]
        if number == 0:
            # The truth has no error: its place in this column is free for the scale.
            pictures[2][:] = rgb255(PAPER)
            heat_legend(pictures[2], "error, mm", limit_mm)
        gap = np.full((HEIGHT, GAP, 3), rgb255(PAPER), np.uint8)
        line = np.hstack([part for each in pictures for part in (each, gap)][:-1])
        lines += [caption(line.shape[1], *strip.words, height=22), line]
    return np.vstack(lines)


def _still(
    strip: Strip,
    camera: Camera,
    recording: Recording | None,
    colors: Float[np.ndarray, "vertices 3"] | None = None,
    *,
    light: tuple[float, float, float] = ShadingConfig.light,
) -> UInt8[np.ndarray, "height width 3"]:
    table = None if recording is None else recording.table
    config = ShadingConfig(supersampling=2, light=light)
    shader = Shader(strip.faces, camera, table=table, config=config)
    return shader.render(strip.vertices, colors=colors).image.copy()


def _close_up(
    recording: Recording, frame: int, points: Float[np.ndarray, "points 3"], strip: Strip | None
) -> UInt8[np.ndarray, "height width 3"]:
    """Return the first camera's picture around the cloth with a strip's mesh; blank without one."""
    camera = recording.cameras[0]
    file = recording.frames[frame].color.get(camera.name)
    if file is None:
        return np.full((HEIGHT, WIDTH, 3), rgb255(PAPER), np.uint8)
    picture = read_color(file)
    if strip is not None:
        _draw_mesh(picture, camera, strip)
    pixels = camera.project(points)[0]
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    half = 0.6 * np.ptp(pixels, axis=0)
    half = np.maximum(half, half[::-1] * [WIDTH / HEIGHT, HEIGHT / WIDTH])
    low = np.clip(middle - half, 0, None).astype(int)
    high = np.minimum(middle + half, [camera.width, camera.height]).astype(int)
    cut = picture[low[1] : high[1], low[0] : high[0]]
    scale = min(HEIGHT / cut.shape[0], WIDTH / cut.shape[1])
    small = cv2.resize(cut, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    framed = np.full((HEIGHT, WIDTH, 3), rgb255(PAPER), np.uint8)
    top, left = (HEIGHT - small.shape[0]) // 2, (WIDTH - small.shape[1]) // 2
    framed[top : top + small.shape[0], left : left + small.shape[1]] = small
    return framed


def _draw_mesh(picture: UInt8[np.ndarray, "height width 3"], camera: Camera, strip: Strip) -> None:
    """Draw the mesh semi-transparent in the colors of its two sides, with its outline."""
    still = Shader(strip.faces, camera).render(strip.vertices)
    inside = still.cloth
    veil = 0.5 * picture[inside] + 0.5 * still.image[inside]
    picture[inside] = veil.astype(np.uint8)
    outlines = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[
        0
    ]
    cv2.drawContours(picture, outlines, -1, rgb255(INK), 1, cv2.LINE_AA)


def rows_of(
    folders: Sequence[Path], recording: str, methods: Sequence[str] | None
) -> list[tuple[str, Path, Row]]:
    """Return rows of a recording, each with its folder and its name in the picture."""
    return [
        (_named(row, several=len(folders) > 1), folder, row)
        for folder in folders
        for source in SOURCES
        if (folder / f"{source}.jsonl").exists()
        for row in read_rows(folder / f"{source}.jsonl")
        if row["recording"] == recording and "error" not in row
        if methods is None or row["variant"] in methods
    ]


def _named(row: Row, *, several: bool) -> str:
    return f"{row['variant']} at {row['provenance']['commit']}" if several else str(row["variant"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the strips and print their paths; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bench", type=Path, required=True, help="folder of the benchmark")
    parser.add_argument("--rows", type=Path, nargs="+", help="folders of rows (BENCH/experiments)")
    parser.add_argument("--recording", nargs="+", required=True, help="names")
    parser.add_argument("--action", type=int, help="from 1; the last by default")
    parser.add_argument("--methods", nargs="+", help="variants; all by default")
    parser.add_argument("--limit-mm", type=float, default=30.0, help="error at the scale's red end")
    parser.add_argument("--image", type=Path, default=Path("docs/images/methods.png"))
    options = parser.parse_args(arguments)
    quiet_warp()
    folders = options.rows or [options.bench / "experiments"]
    pictures = []
    for name in options.recording:
        rows = rows_of(folders, name, options.methods)
        if not rows:
            say(f"no rows of {name} in {', '.join(map(str, folders))}\n")
            return 1
        truth = Truth.load(options.bench / "truth" / f"{name}.npz")
        action = options.action or max(int(row["action"]) for *_, row in rows)
        frame = next(int(row["frame"]) for *_, row in rows if row["action"] == action)
        chosen = strips(rows, truth, action)
        if len(options.recording) > 1:
            chosen[0] = replace(chosen[0], words=(f"{name}: the truth", ""))
        recording = read_recording(options.bench / "recordings" / name)
        pictures.append(draw(chosen, recording, frame, limit_mm=options.limit_mm))
    write_png(options.image, np.vstack(pictures))
    say(f"{options.image}: {options.image.stat().st_size / 1e3:.0f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
