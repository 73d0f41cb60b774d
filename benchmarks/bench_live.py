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

Run with `OMP_NUM_THREADS=1`.

    python benchmarks/bench_live.py --json out/bench_live.json [--quick]
"""

import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from harness import run_benchmark, spread
from staged_fold import CARRIED_STEPS, FILMED_VERTICES, FRAME_RATE, shirt, staged

import clothtrack as ct
from clothtrack.live.playback import pickers_at, play

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
        cloth, (camera,) = self.recording.cloth, self.recording.cameras
        return ct.LiveTracker(cloth, camera, table=self.recording.table)

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


def back_to_back(film: Film) -> tuple[list[Cost], float]:
    """Process all pictures in a row; return their costs, and the last final alignment's [s]."""
    tracker, costs = film.tracker(), []
    for index, picture in enumerate(film.pictures):
        film.turns(tracker, index)
        costs.append(served(tracker, picture))
    start = time.process_time()
    tracker.tracked(film.recording)
    return costs, time.process_time() - start


def on_a_core(film: Film) -> dict[str, float]:
    """Process pictures at the camera's speed on a clock of CPU time, always the newest one."""
    tracker, latencies, free_s = film.tracker(), [], 0.0
    times = [picture["time_s"] for picture in film.pictures]
    turns: list[int] = []
    for index, (arrives_s, next_s) in enumerate(pairwise([*times, np.inf])):
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
        free_s = 0.0 if index == 0 else max(free_s, arrives_s) + cost.cpu_s
        if index > 0:
            latencies.append(free_s - arrives_s)
    tracker.close(film.recording)
    return {**spread(latencies), "dropped_share": tracker.dropped / len(times)}


def on_the_wall(film: Film) -> dict[str, Any]:
    """Play at the camera's speed through a stream, and return the delays of its states."""
    states: list[ct.LiveState] = []
    tracker = film.tracker()
    with ct.LiveStream(tracker, states.append) as stream:
        play(film.recording, stream)
    each = {state.frame: state for state in states}.values()
    late = [state.latency_s for state in each][1:]
    return {
        **spread(late),
        "first_mesh_s": next(iter(each)).latency_s,
        "dropped_share": tracker.dropped / len(film.pictures),
    }


def case(vertex_count: int, rate: float, folder: Path) -> dict[str, Any]:
    """Return one row: the fold with these numbers of vertices and pictures per second."""
    filmed = staged(folder, rate)
    mesh = shirt(vertex_count)
    cloth = replace(filmed.cloth, template=mesh)
    film = Film.of(replace(filmed, cloth=cloth))
    back_to_back(film)  # compiles, and fills the caches
    costs, final_s = back_to_back(film)
    carried = range(1, round(CARRIED_STEPS * rate / FRAME_RATE) + 1)
    acting = [costs[index] for index in carried]
    return {
        "vertices": mesh.vertex_count,
        "rate": rate,
        "pictures": len(costs),
        "wall": spread([one.wall_s for one in acting]),
        "one_core": spread([one.cpu_s for one in acting]),
        "two_cores": spread([one.chain_s for one in acting]),
        "parts": {
            name: spread([one.parts[name] for one in acting if name in one.parts]) for name in PARTS
        },
        "first_mesh_cpu_s": costs[0].cpu_s,
        "final_alignment_cpu_s": final_s,
        "camera_on_one_core": on_a_core(film),
        "camera_on_the_wall": on_the_wall(film),
    }


def measure(folder: Path, quick: bool) -> dict[str, Any]:
    """Record, and track live."""
    cases = [(1000, 30.0)] if quick else [(1000, 30.0), (4000, 10.0)]
    rows = [case(count, rate, folder / f"fold{count}") for count, rate in cases]
    return {"filmed_vertices": FILMED_VERTICES, "rows": rows}


if __name__ == "__main__":
    run_benchmark("live", __doc__, measure)
