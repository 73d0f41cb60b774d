"""Flattening column of Table 2: the same crumpled starts, ten actions each, in the simulated world.

Claims judged: fine-tuning lifts the normalized improvement by 30 % (paper, 0.23 to 0.30); the
fine-tuned network reaches 80 % of what the truth as perception reaches; the learned dynamics are as
good as the simulator. Random actions and the geometric heuristic are baselines without a mesh.
Methods that begin with "control" use the truth and are upper bounds, not results.

    python experiments flattening --out OUT --episodes 20
    python experiments flattening --out OUT --weights FILE --tuned FILE --dynamics FILE

Finished episodes are kept and an interrupted one is resumed; methods without their weights are left
out. `--kind tshirt --kind towel` takes both garments in turn; `--garment-seed N` starts one garment
20 times, as in the paper, one that no shipped network was trained on.
"""

import argparse
import hashlib
import json
import logging
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared import tables
from shared.bench_measures import Row
from shared.bench_runs import read_rows, write_rows
from shared.figures import say

from clothtrack import __version__
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.provenance import commit
from clothtrack.files.settings import with_settings
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.quality import crossings
from clothtrack.planning.action_space import in_picture
from clothtrack.planning.episode_store import EpisodeStore
from clothtrack.planning.flatten_config import FlattenConfig, episode_identity
from clothtrack.planning.flattening import improvement
from clothtrack.planning.perception import PerceptionConfig
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.planning_dynamics import MotionConfig, SimulatorConfig
from clothtrack.reconstruction.availability import missing_modules
from clothtrack.recordings.store import read_recording
from clothtrack_lab.flattening import POLICIES
from clothtrack_lab.graph_dynamics.registered import SHIPPED_WEIGHTS
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.simulated_episodes import (
    EpisodeParts,
    SimulatedEpisode,
    flatten_simulated,
    knowing_the_garment,
)
from clothtrack_lab.world.simulated_robot import SimulatedRobotConfig

NAME = "flattening"
FIRST_SEED = 9000
"""Of the starts; the benchmark's seeds, and those that are learned from, lie below."""

TRUTH = PerceptionConfig(name="truth")


@dataclass(frozen=True)
class Method:
    """One line of the table."""

    name: str
    config: FlattenConfig


@dataclass(frozen=True)
class Task:
    """One episode of one method."""

    method: Method
    episode: SimulatedEpisode
    out: Path
    robot: SimulatedRobotConfig
    device: str = "cpu"

    @property
    def digest(self) -> str:
        """Ten hexadecimal digits that change with every setting and with what is in the weights."""
        asked = episode_identity(self.method.config), asdict(self.robot)
        content = hashlib.sha256(json.dumps(asked, sort_keys=True, default=str).encode())
        return content.hexdigest()[:10]

    @property
    def folder(self) -> Path:
        """Where the method's episodes lie."""
        return self.out / self.digest


def methods(options: argparse.Namespace) -> list[Method]:
    """Return the methods to compare; those that need weights only if their weights are given."""
    base = FlattenConfig(actions=options.actions)
    if options.smoke:
        quick = SimulatorConfig(motion=MotionConfig(speed=0.8, rest_s=0.1))
        base = FlattenConfig(
            actions=2, simulator=quick,
            planner=PlannerConfig(candidates=10),
        )  # fmt: skip
    base = with_settings(base, options.settings)
    found = [
        Method("random", replace(base, policy="random")),
        Method("outwards", replace(base, policy="outwards")),
        Method("heuristic", replace(base, policy="heuristic")),
        Method("control: truth, simulator", replace(base, perception=TRUTH)),
    ]
    learned = {"dynamics": "mesh", "dynamics_weights": str(options.dynamics or SHIPPED_WEIGHTS)}
    if not missing_modules():
        found.append(
            Method("control: truth, learned dynamics", replace(base, perception=TRUTH, **learned))
        )
    for name, weights in (("pretrained", options.weights), ("fine-tuned", options.tuned)):
        if not weights:
            continue
        seen = replace(base, perception=PerceptionConfig(weights=str(weights)))
        found.append(Method(name, seen))
        found.append(Method(f"{name}, learned dynamics", replace(seen, **learned)))
    if options.only:
        known = {one.name for one in found}
        found = [
            one for one in found
            if any(one.name == name if name in known else one.name.startswith(name)
                   for name in options.only)
        ]  # fmt: skip
    return found


def task_of(
    method: Method, episode: SimulatedEpisode, out: Path, robot: SimulatedRobotConfig, device: str
) -> Task:
    """Return one episode of one method, with the template of the single garment, if any."""
    config = knowing_the_garment(method.config, episode.garment, out)
    return Task(replace(method, config=config), episode, out, robot, device)


def run(task: Task) -> list[Row]:
    """Return one episode's rows, one per action; an episode that ended early stays where it was."""
    quiet_warp()
    named = {
        "experiment": NAME,
        "variant": task.method.name,
        "recording": task.episode.label,
        "kind": task.episode.kind,
        "split": "",
    }
    try:
        store = flatten_simulated(
            task.folder,
            task.episode,
            task.method.config,
            robot_config=task.robot,
            parts=EpisodeParts(
                starts=task.out / "starts", propose=POLICIES.get(task.method.config.policy)
            ),
            device=task.device,
        )
    except ClothTrackError as error:
        return [{**named, "error": str(error)}]
    return [{**named, **row} for row in rows_of(store, task)]


def rows_of(store: EpisodeStore, task: Task) -> list[Row]:
    """Return the measures after each action."""
    steps = store.steps
    gained = improvement(steps)
    asked = store.document["asked"]
    flat, start = steps[0]["flat_m2"], steps[0]["true_m2"]
    stamp = {
        "clothtrack": __version__,
        "commit": commit(),
        "device": task.device,
        "seed": task.episode.seed,
        "config_hash": task.digest,
    }
    worlds = [true_world(task, store, number) for number in range(len(steps))]
    rows: list[Row] = []
    for number in range(1, task.method.config.actions + 1):
        done = min(number, len(steps) - 1)
        acted = number == done
        step = steps[done]
        rows.append(
            {
                "action": number,
                "actions": task.method.config.actions,
                "stage": "after",
                "improvement": gained[done],
                "share": step["true_m2"] / flat,
                "seen_share": step["seen_m2"] / flat,
                "start_share": start / flat,
                "used": len(steps) - 1,
                "missed": float(step["grasped"] is False) if acted else None,
                "expected_m2": step["gain_m2"] if acted else None,
                "gain_m2": step["true_m2"] - steps[done - 1]["true_m2"] if acted else None,
                "world_crossings": worlds[done][0] if acted else None,
                "out_of_picture": worlds[done][1],
                "perception_cpu_s": step["perception_cpu_s"] if acted else None,
                "decision_cpu_s": step["decision_cpu_s"] if acted else None,
                "status": store.document["status"],
                "control": asked["label"]["control"],
                "perception": asked["label"]["perception"],
                "provenance": stamp,
            }
        )
    return rows


def true_world(task: Task, store: EpisodeStore, step: int) -> tuple[int, float]:
    """Return the true cloth's self-crossing edges and its hidden share after a step."""
    path = task.folder / "worlds" / task.episode.label / f"{step:02d}.npz"
    with np.load(path, allow_pickle=False) as file:
        positions, faces = file["positions"], file["faces"]
    camera = read_recording(store.recording_path(step)).cameras[0]
    return crossings(positions, faces), 1.0 - float(in_picture(positions, camera, 0.0).mean())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    options = parse(arguments)
    quiet_warp()
    logging.basicConfig(level=logging.INFO if options.verbose else logging.ERROR)
    with tempfile.TemporaryDirectory(prefix=f"{NAME}-") as temporary:
        out = options.out or Path(temporary)
        robot = SimulatedRobotConfig(film=False)
        if options.smoke:
            robot = SimulatedRobotConfig(episode=SMALL_WORLD, film=False)
            if not options.weights and not missing_modules():
                from shared.learning_runs import tiny_network

                options.weights = tiny_network(out / "tiny.safetensors")
        try:
            chosen = methods(options)
            seeds = range(options.first_seed, options.first_seed + options.episodes)
            tasks = [
                task_of(method, SimulatedEpisode(kind, seed, garment_seed=options.garment_seed),
                        out / NAME, robot, options.device)
                for seed in seeds
                for kind in (("towel",) if options.smoke else options.kind)
                for method in chosen
            ]  # fmt: skip
            make_starts(tasks, options.workers)
            order = [one.name for one in chosen]
            rows: list[Row] = []
            for part in finished_in_workers(run, tasks, options.workers):
                rows += noted(part)
                rows.sort(key=lambda row: (order.index(row["variant"]), row["recording"]))
                # After each episode: a run that is stopped leaves a table of what it had.
                write_rows(rows, out / f"{NAME}.jsonl")
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
        if options.smoke:
            say("Smoke run: a napkin, two actions, a network that has learned nothing.\n\n")
        say(f"{__doc__.splitlines()[0]}\n")
        for kind in dict.fromkeys(task.episode.kind for task in tasks):
            own = [row for row in read_rows(out / f"{NAME}.jsonl") if row["kind"] == kind]
            say(f"\n{kind}\n\n{tables.markdown(NAME, own)}")
    return 1 if not rows or all("error" in row for row in rows) else 0


def make_starts(tasks: Sequence[Task], workers: int) -> None:
    """Make the crumpled starts once each, because parallel methods share them."""
    first = {task.episode.label: task for task in reversed(tasks)}
    missing = [
        task for label, task in first.items()
        if not (task.out / "starts" / f"{label}.npz").exists()
    ]  # fmt: skip
    for _ in finished_in_workers(partial(make_start), missing, workers):
        pass


def make_start(task: Task) -> None:
    """One crumpled start."""
    from clothtrack_lab.world.simulated_episodes import begin
    from clothtrack_lab.world.simulated_robot import SimulatedRobot

    episode = task.episode
    robot = SimulatedRobot(episode.kind, episode.seed, task.robot, episode.garment)
    begin(robot, task.out / "starts" / f"{task.episode.label}.npz")


def noted(rows: list[Row]) -> list[Row]:
    """Return the same rows; says that they are there."""
    last = rows[-1]
    text = last.get("error") or f"improvement {last['improvement']:.3f}"
    sys.stderr.write(f"{last['variant']}, {last['recording']}: {text}\n")
    sys.stderr.flush()
    return rows


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder of rows, episodes and starts")
    parser.add_argument("--episodes", type=int, default=20, help="starts of each garment")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="of the starts")
    parser.add_argument("--garment-seed", type=int, help="one garment for all starts")
    parser.add_argument("--kind", action="append", choices=("towel", "tshirt"))
    parser.add_argument("--actions", type=int, default=10, help="of an episode")
    parser.add_argument("--weights", type=Path, help="of the pretrained network")
    parser.add_argument("--tuned", type=Path, help="of the fine-tuned network")
    parser.add_argument(
        "--dynamics",
        type=Path,
        help="of the learned mesh dynamics; those that come along by default",
    )
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", help="methods by name, or by how their names begin"
    )
    parser.add_argument(
        "--set", dest="settings", action="append", default=[], metavar="NAME=VALUE",
        help="of all methods, such as planner.candidates=300",
    )  # fmt: skip
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="does everything run?")
    parser.add_argument("--verbose", action="store_true", help="log what happens")
    options = parser.parse_args(arguments)
    options.kind = options.kind or ["tshirt"]
    if options.smoke:
        options.episodes = 1
    if options.out is None and not options.smoke:
        parser.error("give --out FOLDER, or --smoke")
    if options.episodes < 1 or options.actions < 1:
        raise InvalidConfigError("--episodes and --actions are at least 1")
    return options


if __name__ == "__main__":
    sys.exit(main())
