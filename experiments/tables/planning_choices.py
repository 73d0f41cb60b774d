"""What a choice is worth: the true gain of a dozen actions on each crumpled start.

Of the actions that the planner samples, those are carried out in the simulated world that it would
choose, that the dynamics promise most for, that are placed farthest off the cloth, and a few others
at random; the world goes back to the start before each. So rules can be compared on the same
actions, without episodes: whatever a rule chooses of the dozen, its true gain is known.

    python experiments planning_choices --out OUT --kind tshirt --starts 10 [--weights TOKENS]

A third of the starts are dropped cloth, the others have been pulled outwards once or twice. Starts
that are finished are kept. The gain is fitted to the promise and the distance off the cloth, start
by start: what a metre off the cloth is worth over the promise's slope is the width of a strip
(`planner.strip_m`).
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
from shared.figures import say

from clothtrack.files.atomic_write import atomic_file
from clothtrack.geometry import projected_area, quiet_warp
from clothtrack.planning import FlattenConfig, PerceptionConfig, dynamics_of, perception_of
from clothtrack.planning.action_space import off_cloth, sample_actions
from clothtrack.planning.episode_store import write_step
from clothtrack.planning.perception import Look, Perception
from clothtrack.planning.planner import Hypothesis, Planner
from clothtrack.planning.seen import seen_cloth
from clothtrack_lab.world import SMALL_WORLD, SimulatedRobot, SimulatedRobotConfig
from clothtrack_lab.world.flex import Fabric

FIRST_SEED = 9100
"""Of the starts; episodes begin at others."""

STRIPS_M = (0.0, 0.03, 0.06, 0.09, 0.12, 0.15)
SMOKE = replace(SMALL_WORLD, fabric=Fabric())


def chosen(worth: np.ndarray, gains: np.ndarray, off: np.ndarray, seed: int) -> list[int]:
    """Return a dozen of the actions: by worth, by promise, by distance off the cloth, by chance."""
    places: list[int] = []
    shuffled = np.random.default_rng(seed).permutation(len(worth))
    for order, count in ((np.argsort(-worth), 4), (np.argsort(-gains), 6),
                         (np.argsort(-off), 9), (shuffled, 12)):  # fmt: skip
        places += [int(k) for k in order if int(k) not in places][: max(count - len(places), 0)]
    return places


def looked(robot: SimulatedRobot, folder: Path) -> Look:
    """Take a picture of the cloth, without any action."""
    shown = write_step(folder, [robot.observe()], cloth=robot.cloth, table=robot.table)
    return Look(shown, acted=False)


def measured(
    robot: SimulatedRobot, seed: int, folder: Path, planner: Planner, perception: Perception
) -> dict[str, Any]:
    """Return promises and true gains of a dozen actions of one start."""
    kind = robot.kind
    robot.crumple()
    rng = np.random.default_rng([seed, 0xC401CE])
    for number in range(seed % 3):
        look = looked(robot, folder / f"before{number}")
        seen = seen_cloth(look.recording, look.observation())
        tried = sample_actions(seen, 100, planner.config.space, rng)
        robot.execute(tried[int(np.argmax(off_cloth(seen, tried)))])
    look = looked(robot, folder / "shown")
    seen = seen_cloth(look.recording, look.observation())
    estimate = perception.perceive(look)
    decision = planner.decide(Hypothesis(estimate.flat, estimate.positions, kind), seen, rng)
    off = off_cloth(seen, decision.candidates)
    dozen = chosen(decision.worth_m2, decision.gains_m2, off, seed)
    actions = [decision.candidates[k] for k in dozen]
    flat, positions = robot.true_cloth()
    truth = planner.gains(Hypothesis(flat, positions, kind), seen, actions)
    before_m2 = projected_area(positions, flat.faces)
    robot.save(folder / "world.npz")
    gains = []
    for action in actions:
        robot.restore(folder / "world.npz")
        robot.execute(action)
        gains.append(projected_area(robot.true_cloth()[1], flat.faces) - before_m2)
    return {
        "start": f"{kind}_{seed}",
        "expected_error_m": estimate.expected_error_m,
        "coverage": before_m2 / projected_area(flat.vertices, flat.faces),
        "all_gains_m2": decision.gains_m2.tolist(),
        "all_off_m": off.tolist(),
        "off_m": off[dozen].tolist(),
        "promised_m2": decision.gains_m2[dozen].tolist(),
        "promised_by_truth_m2": truth.tolist(),
        "gain_m2": gains,
        "actions": [action.as_dict() for action in actions],
    }


def fitted(rows: Sequence[dict[str, Any]], promise: str) -> str:
    """A line: slopes of the gain over the promise and over the distance off the cloth."""
    columns = {"gain_m2": 1e4, promise: 1e4, "off_m": 1.0}
    gain, promised, off = (
        np.concatenate([scale * (np.array(row[name]) - np.mean(row[name])) for row in rows])
        for name, scale in columns.items()
    )
    inputs = np.stack([promised, off], axis=1)
    slopes = np.linalg.lstsq(inputs, gain, rcond=None)[0]
    left = gain - inputs @ slopes
    variance = left @ left / max(len(gain) - len(rows) - 2, 1)
    error = np.sqrt(variance * np.diag(np.linalg.pinv(inputs.T @ inputs)))
    known = 1.0 - left @ left / (gain @ gain)
    return (
        f"| {slopes[0]:.2f} ± {error[0]:.2f} | {slopes[1]:.0f} ± {error[1]:.0f} | "
        f"{slopes[1] / slopes[0] / 1e4:.3f} | {100 * known:.0f} % |"
    )


def won(rows: Sequence[dict[str, Any]], promise: str, strip_m: float) -> str:
    """The mean true gain [cm2] of the action that a strip chooses of the dozen."""
    gains = []
    for row in rows:
        promised, off = (np.array(row[name]) for name in (promise, "off_m"))
        order = np.lexsort((-(promised + strip_m * off), promised <= 0.0))
        gains.append(1e4 * row["gain_m2"][order[0]])
    return f"{np.mean(gains):.0f} ± {np.std(gains) / np.sqrt(len(gains)):.0f}"


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Both tables."""
    beliefs = {"the network's mesh": "promised_m2", "*the truth*": "promised_by_truth_m2"}
    lines = ["| planned from | per promised cm2 | per meter off, cm2 | strip, m | known |"]
    lines.append("|---" * 5 + "|")
    lines += [f"| {name} {fitted(rows, promise)}" for name, promise in beliefs.items()]
    head = " | ".join(f"strip {100 * strip_m:.0f} cm" for strip_m in STRIPS_M)
    lines += ["", f"| won, cm2 | {head} |", "|---" * (1 + len(STRIPS_M)) + "|"]
    for name, promise in beliefs.items():
        cells = " | ".join(won(rows, promise, strip_m) for strip_m in STRIPS_M)
        lines.append(f"| {name} | {cells} |")
    off = [1e4 * row["gain_m2"][int(np.argmax(row["off_m"]))] for row in rows]
    lines.append(
        f"\nFarthest off the cloth: {np.mean(off):.0f} ± {np.std(off) / len(off) ** 0.5:.0f}."
    )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the starts")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--weights", default="", help="of the network; those of the package")
    parser.add_argument("--smoke", action="store_true", help="one napkin")
    options = parser.parse_args(arguments)
    robot = SimulatedRobotConfig(film=False)
    if options.smoke:
        options.kind, options.starts, robot = "towel", 1, replace(robot, episode=SMOKE)
    quiet_warp()
    config = FlattenConfig(perception=PerceptionConfig(weights=options.weights))
    perception = perception_of(options.kind, config.perception)
    planner = Planner(dynamics_of(config), config.planner)
    rows = []
    for seed in range(FIRST_SEED, FIRST_SEED + options.starts):
        folder = options.out / f"{options.kind}_{seed}"
        done = folder / "row.json"
        if not done.exists():
            folder.mkdir(parents=True, exist_ok=True)
            row = measured(
                SimulatedRobot(options.kind, seed, robot), seed, folder, planner, perception
            )
            with atomic_file(done) as unfinished:
                unfinished.write_text(json.dumps(row), encoding="utf-8")
        rows.append(json.loads(done.read_text()))
    say(f"{__doc__.splitlines()[0]}\n\n{len(rows)} starts ({options.kind})\n\n{markdown(rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
