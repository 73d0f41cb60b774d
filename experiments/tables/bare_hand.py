"""Compare clicks with a measured path on simulated recordings of a hand, each tracked twice.

    python experiments bare_hand --out out/bare_hand

The world's tool is as thick as a hand and an arm, and hides the cloth in the same manner. Every
recording is tracked with the path that the world recorded, and with one from clicks at the true
picks and places, off by some pixels and up to three frames. The tables go into
docs/notebook/recording.md.
`--films 2` stops after two recordings, and each row is written when it is finished; `--smoke`
records one small towel.
"""

import argparse
import json
import os
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.figures import say
from shared.table_column import table

import clothtrack as ct
from clothtrack.geometry.devices import quiet_warp
from clothtrack.simulation.pick_and_place import ActionConfig
from clothtrack_capture.carried_path import CarriedPath
from clothtrack_capture.clicked_picking import ClickedAction, ClickedPicking
from clothtrack_capture.cloth_views import Click
from clothtrack_lab.world.episodes import SMALL_WORLD, EpisodeConfig, simulate_trajectory
from clothtrack_lab.world.template_mesh import TemplateConfig
from clothtrack_lab.world.tool import Tool

FILMS = (("towel", 300), ("tshirt", 300), ("towel", 301), ("tshirt", 301))
HAND_M = (
    (0.0, 0.008),
    (0.03, 0.010),
    (0.06, 0.026),
    (0.11, 0.042),
    (0.19, 0.030),
    (0.45, 0.045),
    (0.9, 0.050),
)
"""Distance from the fingertips [m] and radius there [m]: fingers, hand, wrist and arm."""
CLICK_NOISE_PIXELS = 3.0
CLICK_NOISE_FRAMES = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Record missing ones, click, track every recording twice, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for films, runs and rows")
    parser.add_argument("--smoke", action="store_true", help="one small towel, uncalibrated")
    parser.add_argument("--films", type=int, default=len(FILMS), help="only the first ones")
    options = parser.parse_args(arguments)
    quiet_warp()
    settings = ("search.method=none",) if options.smoke else ()
    rows = []
    for kind, seed in FILMS[: 1 if options.smoke else options.films]:
        film = filmed(options.out, kind, seed, smoke=options.smoke)
        clicked = options.out / "clicked" / film.name
        actions = click(film, clicked, seed)
        found = path_rows(film, actions)
        for name, folder in (("true", film), ("clicked", clicked)):
            errors = tracked_errors(folder, options.out, name, settings)
            for row, error in zip(found, errors, strict=True):
                row[f"error_{name}_mm"] = error
        rows += found
        lines = "".join(json.dumps(row) + "\n" for row in rows)
        (options.out / "bare_hand.jsonl").write_text(lines, encoding="utf-8")
    say(markdown(rows))
    return 0


def filmed(out: Path, kind: str, seed: int, *, smoke: bool) -> Path:
    """Return a recording of a hand; an existing one is kept."""
    folder = out / "recordings" / f"{kind}_{seed:04d}"
    if not folder.exists():
        rng = np.random.default_rng(seed)
        # A person sits at the near side of the table; the arm comes in steeper than a rod.
        tool = Tool(
            azimuth_rad=float(-np.pi / 2.0 + rng.uniform(-0.7, 0.7)),
            elevation_rad=float(np.radians(rng.uniform(40.0, 55.0))),
            radii_m=HAND_M,
        )
        # A coarse first mesh: both runs of a film share it, and track three times as fast.
        config = EpisodeConfig(actions=2, tool=tool, template=TemplateConfig(vertex_count=500))
        if smoke:
            config = replace(SMALL_WORLD, tool=tool, action=ActionConfig(frame_rate=20.0))
        simulate_trajectory(kind, seed, out, config=config)
    return folder


def click(film: Path, target: Path, seed: int) -> tuple[ClickedAction, ...]:
    """Make a copy of a recording with a path from noisy clicks at the true picks and places."""
    recording = ct.read_recording(film)
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(film, target, copy_function=_link)
    for name in ("recording.json", "picker.csv"):
        (target / name).unlink()
    document = json.loads((film / "recording.json").read_text(encoding="utf-8"))
    del document["actions"]
    (target / "recording.json").write_text(json.dumps(document), encoding="utf-8")
    path, camera = recording.picker_paths["gripper"], recording.cameras[0]
    picking = ClickedPicking(ct.read_recording(target), camera)
    rng, last = np.random.default_rng(seed), len(recording.frames) - 1
    for frame in np.concatenate(holds(path)).tolist():
        (pixel,), _ = camera.project(path.positions[frame][None])
        column, row = np.rint(rng.normal(pixel, CLICK_NOISE_PIXELS)).astype(int).tolist()
        off = int(rng.integers(-CLICK_NOISE_FRAMES, CLICK_NOISE_FRAMES + 1))
        picking.add(Click(min(max(frame + off, 0), last), column, row))
    picking.keep("hand")
    return picking.actions()


def holds(path: ct.PickerPath) -> list[tuple[int, int]]:
    """Frames in which the world's gripper closes and in which it is open again."""
    change = np.diff(path.closed.astype(int))
    picks, releases = (np.flatnonzero(change == sign) + 1 for sign in (1, -1))
    return list(zip(picks.tolist(), releases.tolist(), strict=True))


def path_rows(film: Path, actions: Sequence[ClickedAction]) -> list[dict[str, Any]]:
    """Return the error of each action's path, with and without the fit to the cloth."""
    recording = ct.read_recording(film)
    path, times = recording.picker_paths["gripper"], [f.time_s for f in recording.frames]
    rows = []
    for number, ((pick, release), action) in enumerate(zip(holds(path), actions, strict=True)):
        held, found = slice(pick, release + 1), action.path
        true, moments = path.positions[held], np.array(times[held])
        alone = CarriedPath(
            found.pick, found.place, found.up,
            times[action.pick.frame], times[action.place.frame],
        )  # fmt: skip
        rows.append(
            {
                "film": film.name,
                "action": number + 1,
                "clicked_off": f"{action.pick.frame - pick:+d}, {action.place.frame - release:+d}",
                "seen": action.seen,
                "pick_mm": _mm(found.pick - true[0]),
                "place_mm": _mm(found.place - true[-1]),
                "lift_mm": round(1e3 * found.lift_m),
                "true_lift_mm": round(1e3 * (true[:, 2].max() - max(true[0, 2], true[-1, 2]))),
                "path_by_clicks_alone_mm": _mm(alone.positions_at(moments) - true),
                "path_mm": _mm(found.positions_at(moments) - true),
            }
        )
    return rows


def tracked_errors(folder: Path, out: Path, name: str, settings: Sequence[str]) -> list[float]:
    """Return the mean vertex error after each action [mm]; runs are kept."""
    result = out / name / f"{folder.name}.zarr"
    if not result.exists():
        result.parent.mkdir(parents=True, exist_ok=True)
        ct.track(folder, settings=settings).save(result)
    evaluation = ct.evaluate(ct.load(result, folder), truth=out / "truth")
    return [
        round(row.vertex_error_mm["all"].mean, 1)
        for row in evaluation.rows
        if row.stage == "after_final_alignment"
    ]


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as a table, and their means."""
    names = list(rows[0])
    lines = [[str(row[name]) for name in names] for row in rows]
    numbers = [name for name in names if name.endswith("_mm")]
    mean = {name: round(float(np.mean([row[name] for row in rows])), 1) for name in numbers}
    lines.append([str(mean.get(name, "mean" if name == "film" else "")) for name in names])
    return table(names, lines)


def _mm(difference: Float[np.ndarray, "*points 3"]) -> float:
    return round(1e3 * float(np.linalg.norm(difference, axis=-1).mean()), 1)


def _link(source: str, target: str) -> None:
    os.link(source, target)


if __name__ == "__main__":
    sys.exit(main())
