"""Latency of the live mesh and cost per picture.

The fold of staged_fold.py, recorded in 640 x 480 at 30 pictures per second (10 for 4,000 vertices),
is in memory and goes through `ct.LiveTracker`:

- each picture as soon as the one before is done: wall time of `update`, its CPU time in all threads
  (what one core needs), and the CPU time of its longest chain (what two idle cores need: the next
  cloud is made while the dynamics predict), by part;
- at the speed of the camera, on a clock that counts CPU time: pictures that come while an older one
  is served wait, and are dropped when a newer one comes. On a busy machine this says what an idle
  core would drop;
- at the speed of the camera through `ct.LiveStream`, on the wall's clock.

With `--recordings DIR --truth DIR` each recording there is tracked live, with the pictures that one
core drops, and offline, without and with a search, and the true errors of the labels are compared.
Run with `OMP_NUM_THREADS=1`.

    python benchmarks/bench_live.py --json out/bench_live.json [--quick]
    python benchmarks/bench_live.py --json FILE --recordings out/world/recordings \
        --truth out/world/truth

`--soak MINUTES` only tracks this many minutes of video as fast as it can (the shipped recording
forwards and backwards, repeatedly), and prints the memory of the process.

    python benchmarks/bench_live.py --json out/soak.json --soak 60
"""

import argparse
import gc
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from results import provenance, write_json
from staged_fold import CARRIED_STEPS, FILMED_VERTICES, FRAME_RATE, shirt, staged

import clothtrack as ct
from clothtrack.geometry import quiet_warp
from clothtrack.live.playback import pickers_at, play

SOAK_EVERY = 500
PARTS = ("observe", "predict", "align", "correct")


@dataclass(frozen=True)
class Film:
    """A recording in memory, with the arrival time of each picture [s]."""

    recording: ct.Recording
    pictures: tuple[dict[str, Any], ...]

    @classmethod
    def of(cls, recording: ct.Recording) -> "Film":
        """Read every picture."""
        (camera,) = recording.cameras
        unit_m = recording.depth_units_m[camera.name]
        return cls(
            recording,
            tuple(
                {
                    "time_s": frame.time_s,
                    "depth": ct.read_depth(frame.depth[camera.name], unit_m),
                    "color": ct.read_color(frame.color[camera.name]),
                    "picker": pickers_at(recording, frame),
                }
                for frame in recording.frames
            ),
        )

    def tracker(self) -> ct.LiveTracker:
        """Return a tracker for its cloth."""
        recording = self.recording
        return ct.LiveTracker(recording.cloth, recording.cameras[0], table=recording.table)

    def turns(self, tracker: Any, index: int) -> None:
        """Begin and end actions as in the recording."""
        for action in self.recording.actions:
            if action.last_frame == index:
                tracker.end_action()
            if action.first_frame == index:
                tracker.begin_action()


@dataclass
class Cost:
    """The cost of one picture [s]."""

    wall_s: float
    cpu_s: float
    chain_s: float
    parts: dict[str, float]


def served(tracker: ct.LiveTracker, picture: dict[str, Any]) -> Cost:
    """Process one picture and return its cost."""
    wall, cpu, own = time.perf_counter(), time.process_time(), time.thread_time()
    state = tracker.update(**picture)
    own_s = time.thread_time() - own
    parts = dict(state.spent_s)
    # Until the cloud is needed the dynamics predict.
    waited_s = max(0.0, parts.get("observe", 0.0) - parts.get("predict", 0.0))
    return Cost(time.perf_counter() - wall, time.process_time() - cpu, own_s + waited_s, parts)


def back_to_back(film: Film) -> tuple[list[Cost], float, ct.Run]:
    """Process all pictures, each as soon as the one before is done.

    Returns:
        The cost of each, the CPU time of the last final alignment [s], and the run.
    """
    tracker, costs = film.tracker(), []
    for index, picture in enumerate(film.pictures):
        film.turns(tracker, index)
        costs.append(served(tracker, picture))
    start = time.process_time()
    tracked, _ = tracker.tracked(film.recording)
    return costs, time.process_time() - start, ct.Run.of(tracked, film.recording)


def on_a_core(film: Film) -> tuple[list[float], int, ct.Run]:
    """Process pictures at the camera's speed on a clock of CPU time, always the newest one.

    Returns:
        The latencies of all processed pictures but the first [s], the number of dropped pictures,
        and the run.
    """
    tracker, latencies, free_s = film.tracker(), [], 0.0
    turns: list[int] = []
    for place, (index, arrives_s, next_s) in enumerate(_arrivals(film)):
        turns.append(index)
        if max(free_s, arrives_s) >= next_s:
            picture = film.pictures[index]
            tracker.drop(picture["time_s"], picture["picker"])
            continue
        for turn in turns:
            film.turns(tracker, turn)
        turns.clear()
        cost = served(tracker, film.pictures[index])
        # The camera is switched on when the first mesh is there.
        free_s = 0.0 if place == 0 else max(free_s, arrives_s) + cost.cpu_s
        if place > 0:
            latencies.append(free_s - arrives_s)
    return latencies, tracker.dropped, tracker.close(film.recording)


def _arrivals(film: Film) -> Iterator[tuple[int, float, float]]:
    """Yield the number and time of every picture, and the time of the next one [s]."""
    times = [picture["time_s"] for picture in film.pictures]
    yield from zip(range(len(times)), times, [*times[1:], np.inf], strict=True)


def on_the_wall(film: Film) -> dict[str, Any]:
    """Play at the camera's speed through a stream, and return the delays of its states."""
    states: list[ct.LiveState] = []
    tracker = film.tracker()
    with ct.LiveStream(tracker, states.append) as stream:
        play(film.recording, stream)
    each = {state.frame: state for state in states}.values()
    late = [state.latency_s for state in each][1:]
    return {
        **_spread(late),
        "first_mesh_s": next(iter(each)).latency_s,
        "dropped_share": tracker.dropped / len(film.pictures),
    }


def _spread(seconds: list[float]) -> dict[str, float]:
    median, most = np.percentile(seconds, [50, 95]).tolist()
    return {"median_s": median, "p95_s": most}


def case(vertex_count: int, rate: float, folder: Path) -> dict[str, Any]:
    """Return one row: the fold with these numbers of vertices and pictures per second."""
    filmed = staged(folder, rate)
    mesh = shirt(vertex_count)
    cloth = replace(filmed.cloth, template=mesh)
    film = Film.of(replace(filmed, cloth=cloth))
    back_to_back(film)  # compiles, and fills the caches
    costs, final_s, _ = back_to_back(film)
    carried = range(1, round(CARRIED_STEPS * rate / FRAME_RATE) + 1)
    acting = [costs[index] for index in carried]
    latencies, dropped, _ = on_a_core(film)
    return {
        "vertices": mesh.vertex_count,
        "rate": rate,
        "pictures": len(costs),
        "wall": _spread([one.wall_s for one in acting]),
        "one_core": _spread([one.cpu_s for one in acting]),
        "two_cores": _spread([one.chain_s for one in acting]),
        "parts": {
            name: _spread([one.parts[name] for one in acting if name in one.parts])
            for name in PARTS
        },
        "first_mesh_cpu_s": costs[0].cpu_s,
        "final_alignment_cpu_s": final_s,
        "camera_on_one_core": {**_spread(latencies), "dropped_share": dropped / len(costs)},
        "camera_on_the_wall": on_the_wall(film),
    }


def errors(recordings: Path, truth: Path) -> list[dict[str, Any]]:
    """Return true errors of the labels, live on one core and offline, without and with a search."""
    rows = []
    for folder in sorted(path.parent for path in recordings.glob("*/recording.json")):
        film = Film.of(ct.read_recording(folder))
        known = ct.Truth.load(truth / f"{folder.name}.npz")
        offline = ct.track(film.recording, settings=["search.method=none"])
        every, _, same = back_to_back(film)
        late, dropped, live = on_a_core(film)
        runs = {
            "offline_mm": offline,
            "live_mm": live,
            "offline_searched_mm": ct.track(film.recording),
        }
        verdicts = {name.replace("_mm", "_verdict"): one.verdict.word for name, one in runs.items()}
        means = {name: _labels_mm(ct.evaluate(run, truth=known)) for name, run in runs.items()}
        rows.append(
            {
                "recording": folder.name,
                "vertices": offline.mesh.vertex_count,
                "same_bits_when_nothing_is_dropped": bool(
                    np.array_equal(same.positions, offline.positions)
                ),
                "one_core": _spread([one.cpu_s for one in every[1:]]),
                "dropped_share": dropped / len(film.pictures),
                "latency": _spread(late),
                **means,
                **verdicts,
            }
        )
    return rows


def _labels_mm(evaluation: Any) -> list[float]:
    """Return the mean vertex error of each label [mm]."""
    after = [row for row in evaluation.rows if row.stage == "after_final_alignment"]
    return [row.vertex_error_mm["all"].mean for row in after]


def soak(minutes: float) -> dict[str, Any]:
    """Return the memory of the process [MB] against pictures, over minutes of video."""
    recording = ct.read_recording(ct.shipped_recording())
    film = Film.of(recording)
    step_s = film.pictures[1]["time_s"] - film.pictures[0]["time_s"]
    there_and_back = [*film.pictures, *film.pictures[::-1]]
    tracker, served, rows, began = film.tracker(), 0, [], time.process_time()
    while served * step_s < 60.0 * minutes:
        for picture in there_and_back:
            tracker.update(**(picture | {"time_s": served * step_s}))
            served += 1
            if served % SOAK_EVERY == 0:
                rows.append({"pictures": served, "resident_mb": _resident_mb()})
                sys.stderr.write(f"{rows[-1]}\n")
    cpu_s = time.process_time() - began
    actions = len(tracker.recording.actions)
    return {
        "minutes": served * step_s / 60.0,
        "pictures": served,
        "actions": actions,
        "cpu_s": cpu_s,
        "memory": rows,
        "bytes_a_picture": _slope(rows),
        "after_close_mb": _closed_mb(tracker),
    }


def _closed_mb(tracker: ct.LiveTracker) -> float:
    tracked, _ = tracker.tracked()
    tracked.positions[-1].sum()
    return _resident_mb()


def _resident_mb() -> float:
    """Return the current memory of the process [MB], without memory mapped from files."""
    gc.collect()
    words = Path("/proc/self/status").read_text(encoding="ascii").split()
    return int(words[words.index("RssAnon:") + 1]) / 1024.0


def _slope(rows: list[dict[str, float]]) -> float:
    """Return the growth over the second half, by least squares [bytes per picture]."""
    half = rows[len(rows) // 2 :]
    x, y = (np.array([row[name] for row in half]) for name in ("pictures", "resident_mb"))
    return float(np.polyfit(x, y, 1)[0] * 2**20)


def table(rows: list[dict[str, Any]], compared: list[dict[str, Any]]) -> str:
    """Return the rows as text."""
    lines = ["[ms] median / 95 %, while the picker carries the cloth"]
    for row in rows:
        times = {name: row[name] for name in ("wall", "one_core", "two_cores")} | row["parts"]
        cells = ", ".join(f"{name} {_cell(spread)}" for name, spread in times.items())
        lines += [
            f"{row['vertices']} vertices, {row['rate']:.0f}/s: {cells}",
            f"  first mesh {row['first_mesh_cpu_s']:.2f} s CPU, final alignment "
            f"{row['final_alignment_cpu_s']:.2f} s",
        ]
        for name in ("camera_on_one_core", "camera_on_the_wall"):
            spread = row[name]
            share = 100 * spread["dropped_share"]
            lines.append(f"  {name.replace('_', ' ')}: {_cell(spread)}, {share:.0f} % dropped")
    for row in compared:
        names = ("offline_mm", "live_mm", "offline_searched_mm")
        labels = zip(*(row[name] for name in names), strict=True)
        words = ", ".join(" / ".join(f"{one:.2f}" for one in label) for label in labels)
        said = " / ".join(row[name.replace("_mm", "_verdict")] for name in names)
        same = "same bits" if row["same_bits_when_nothing_is_dropped"] else "OTHER BITS"
        lines.append(
            f"{row['recording']} ({row['vertices']} vertices, {100 * row['dropped_share']:.0f} % "
            f"dropped): offline / live / offline searched {words} mm, "
            f"{said}; nothing dropped: {same}"
        )
    return "\n".join(lines) + "\n"


def _cell(spread: dict[str, float]) -> str:
    return f"{1e3 * spread['median_s']:.1f} / {1e3 * spread['p95_s']:.1f}"


def main() -> None:
    """Record, track live, compare and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="where the result goes")
    parser.add_argument("--quick", action="store_true", help="1,000 vertices alone")
    parser.add_argument("--recordings", type=Path, help="simulated recordings to compare errors on")
    parser.add_argument("--truth", type=Path, help="their truth")
    parser.add_argument("--soak", type=float, metavar="MINUTES", help="memory over so much film")
    options = parser.parse_args()
    quiet_warp()
    if options.soak:
        found = soak(options.soak)
        write_json(options.json, {"benchmark": "live_soak", **found, "provenance": provenance()})
        sys.stdout.write(f"{found}\n")
        return
    cases = [(1000, 30.0)] if options.quick else [(1000, 30.0), (4000, 10.0)]
    with tempfile.TemporaryDirectory(prefix="bench-live-") as folder:
        rows = [case(count, rate, Path(folder) / f"fold{count}") for count, rate in cases]
    compared = errors(options.recordings, options.truth) if options.recordings else []
    write_json(
        options.json,
        {
            "benchmark": "live",
            "filmed_vertices": FILMED_VERTICES,
            "rows": rows,
            "errors": compared,
            "provenance": provenance(),
        },
    )
    sys.stdout.write(table(rows, compared))


if __name__ == "__main__":
    main()
