"""Measure how well the picker is found in simulated recordings, against the truth.

    python experiments picker_from_pictures --out out/picker_from_pictures

The films are those of `clothtrack simulate`, with a colored tip and an exactly recorded path. The
table goes into docs/notebook/recording.md. `--films 2` stops after two, each row is written when it
is there; `--smoke` films one small towel.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np

from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.store import read_recording
from clothtrack.simulation.pick_and_place import ActionConfig
from clothtrack_capture.picker_detection import find_picker, nearest_visible_vertex
from clothtrack_capture.tip_finder import tip_colors
from clothtrack_lab.world.episodes import SMALL_WORLD, EpisodeConfig, simulate_trajectory

FILMS = (
    ("towel", 100, "pink"),
    ("tshirt", 100, "pink"),
    ("towel", 101, "cyan"),
    ("tshirt", 101, "yellow"),
    ("towel", 102, "pink"),
    ("tshirt", 102, "cyan"),
    ("towel", 103, "yellow"),
    ("tshirt", 103, "pink"),
)
EXACT = {"picker_bias_m": 0.0, "picker_noise_m": 0.0}


def main(arguments: Sequence[str] | None = None) -> int:
    """Film what is missing, find the picker in every film, and write a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for films and rows")
    parser.add_argument("--smoke", action="store_true", help="one small towel")
    parser.add_argument("--films", type=int, default=len(FILMS), help="only the first ones")
    options = parser.parse_args(arguments)
    quiet_warp()
    config = EpisodeConfig(**EXACT)
    films = FILMS[: options.films]
    if options.smoke:
        action, sensor = ActionConfig(frame_rate=20.0), SensorConfig()
        config = replace(SMALL_WORLD, action=action, sensor=sensor, **EXACT)
        films = FILMS[:1]
    rows = []
    for kind, seed, tip in films:
        folder = options.out / "recordings" / f"{kind}_{seed:04d}"
        if not folder.exists():
            simulate_trajectory(kind, seed, options.out, config=config, tip_color=tip)
        rows.append(measured(folder, options.out / "truth" / f"{folder.name}.npz", tip))
        lines = "".join(json.dumps(row) + "\n" for row in rows)
        (options.out / "picker_from_pictures.jsonl").write_text(lines, encoding="utf-8")
    sys.stdout.write(markdown(rows))
    return 0


def measured(folder: Path, truth: Path, tip: str) -> dict[str, Any]:
    """Return errors of the picker found in one film, against the path that the world recorded."""
    recording = read_recording(folder)
    camera, path = recording.cameras[0], recording.picker_paths["gripper"]
    found = find_picker(recording, camera, tip_colors(tip))
    errors = np.array(
        [
            np.linalg.norm(found.path.position_at(frame.time_s) - path.positions[frame.index])
            for frame in recording.frames
            if found.seen[frame.index]
        ]
    )
    change = np.diff(path.closed.astype(int))
    picks, releases = np.flatnonzero(change == 1) + 1, np.flatnonzero(change == -1) + 1
    complete = len(found.picks) == len(picks)
    with np.load(truth) as arrays:
        positions, faces = arrays["positions"].astype(np.float64), arrays["faces"]
    right = 0
    for number, place in zip(found.picks, picks, strict=False):
        cloth = ClothMesh(positions[place], faces)
        text = found.path.position_at(recording.frames[number].time_s)
        vertex = nearest_visible_vertex(cloth, text, [camera])
        right += vertex == nearest_visible_vertex(cloth, path.positions[place], [camera])
    return {
        "film": folder.name,
        "tip": tip,
        "cloth": recording.cloth.color,
        "seen": round(float(found.seen.mean()), 3),
        "median_mm": round(1e3 * float(np.median(errors)), 2),
        "p95_mm": round(1e3 * float(np.percentile(errors, 95)), 2),
        "max_mm": round(1e3 * float(errors.max()), 1),
        "picks": len(picks),
        "picks_found": len(found.picks),
        "pick_off": int(np.abs(found.picks - picks).max()) if complete else None,
        "release_off": int(np.abs(found.releases - releases).max()) if complete else None,
        "right_vertex": int(right),
    }


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as a table."""
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    lines += ["| " + " | ".join(str(row[name]) for name in names) + " |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
