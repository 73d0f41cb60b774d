"""What a choice is worth: the true gain of each action that a planner would choose.

Actions of a crumpled start are judged by every planner (`PLANNERS`) with every belief (`PERCEIVED`,
either order of the layers, and the truth). Those that any of them would choose, with a strip of any
width (`planner.strip_m`), are carried out in the simulated world, which goes back to the start
before each; the one placed farthest off the cloth and two at random, too. So planners are compared
on the same starts, without episodes.

    python experiments planning_choices --out OUT --kind tshirt --starts 20 [--weights TOKENS]

A third of the starts are dropped cloth, the others have been pulled outwards once or twice. Starts
that are finished are kept. The gain is fitted to the promise and the distance off the cloth, start
by start: what a metre off the cloth is worth over the promise's slope is the width of a strip.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.bench_measures import in_order
from shared.figures import say
from shared.learning_measures import where_in

from clothtrack.errors import ClothTrackError
from clothtrack.evaluation import material_points
from clothtrack.files import with_settings
from clothtrack.files.atomic_write import atomic_file
from clothtrack.geometry import ClothMesh, projected_area, quiet_warp
from clothtrack.planning import FlattenConfig, PerceptionConfig, dynamics_of, perception_of
from clothtrack.planning.action_space import off_cloth, pick_weights, sample_actions
from clothtrack.planning.episode_store import write_step
from clothtrack.planning.perception import Estimate, Look, Perception
from clothtrack.planning.planner import Hypothesis, Planner, ranked
from clothtrack.planning.seen import seen_cloth
from clothtrack.reconstruction.first_mesh import symmetries
from clothtrack_lab.world import SMALL_WORLD, SimulatedRobot, SimulatedRobotConfig
from clothtrack_lab.world.flex import Fabric

FIRST_SEED = 9100
"""Of the starts; episodes begin at others."""

STRIPS_M = (0.0, 0.03, 0.06, 0.09, 0.12)
SMOKE = replace(SMALL_WORLD, fabric=Fabric())

PERCEIVED = ("refined", "laid")
"""The network's mesh, and the same before it is refined. Beside them, either order of its layers is
believed (the default), and the truth."""

PLANNERS: dict[str, tuple[str, ...]] = {
    "default": (),
    "25 mm": (
        "simulator.coarse.spacing_m=0.025",
        "simulator.coarse.most_vertices=400",
        "simulator.parameters.bend_compliance=30",
    ),
}
"""Settings of `FlattenConfig`; 25 mm was the default until it lost here."""


def chosen(
    gains_m2: Mapping[str, np.ndarray], off_m: np.ndarray, rng: np.random.Generator
) -> list[int]:
    """Return the actions that anyone would choose, the farthest off the cloth, two by chance."""
    places = [
        preferred(gains, off_m, strip_m) for gains in gains_m2.values() for strip_m in STRIPS_M
    ]
    places += [int(np.argmax(off_m)), *rng.integers(len(off_m), size=2).tolist()]
    return list(dict.fromkeys(places))


def preferred(gains_m2: np.ndarray, off_m: np.ndarray, strip_m: float) -> int:
    """Return the action that is chosen with a strip of this width."""
    return int(ranked(gains_m2, gains_m2 + strip_m * off_m)[0])


def looked(robot: SimulatedRobot, folder: Path) -> Look:
    """Take a picture of the cloth, without any action."""
    shown = write_step(folder, [robot.observe()], cloth=robot.cloth, table=robot.table)
    return Look(shown, acted=False)


def measured(
    robot: SimulatedRobot,
    seed: int,
    folder: Path,
    planners: Mapping[str, Planner],
    perceptions: Mapping[str, Perception],
    *,
    candidates: int,
) -> dict[str, Any]:
    """Return promises and true gains of what anyone would choose at one start."""
    robot.crumple()
    rng = np.random.default_rng([seed, 0xC401CE])
    space = next(iter(planners.values())).config.space
    for number in range(seed % 3):
        look = looked(robot, folder / f"before{number}")
        seen = seen_cloth(look.recording, look.observation())
        tried = sample_actions(seen, candidates, space, rng)
        robot.execute(tried[int(np.argmax(off_cloth(seen, tried)))])
    look = looked(robot, folder / "shown")
    seen = seen_cloth(look.recording, look.observation())
    found = {name: each.perceive(look) for name, each in perceptions.items()}
    flat, positions = robot.true_cloth()
    found["truth"] = Estimate(flat, positions, "control: truth")
    beliefs = {name: Hypothesis(one.flat, one.positions, robot.kind) for name, one in found.items()}
    refined = beliefs["refined"]
    beliefs["either order"] = replace(refined, opposite=found["refined"].opposite)
    weights = pick_weights(seen.cloud, refined.flat, refined.positions)
    tried = sample_actions(seen, candidates, space, rng, weights=weights)
    off_m = off_cloth(seen, tried)
    gains_m2 = {
        f"{belief}, {name}": planner.gains(beliefs[belief], seen, tried)
        for name, planner in planners.items()
        for belief in beliefs
    }
    done = chosen(gains_m2, off_m, rng)
    before_m2 = projected_area(positions, flat.faces)
    robot.save(folder / "world.npz")
    true_m2 = []
    for number in done:
        robot.restore(folder / "world.npz")
        robot.execute(tried[number])
        true_m2.append(projected_area(robot.true_cloth()[1], flat.faces) - before_m2)
    return {
        "start": f"{robot.kind}_{seed}",
        "expected_error_m": found["refined"].expected_error_m,
        "beliefs": {
            name: _against_truth(found[name], flat, positions, robot.kind) for name in perceptions
        },
        "coverage": before_m2 / projected_area(flat.vertices, flat.faces),
        "actions": [action.as_dict() for action in tried],
        "off_m": off_m.tolist(),
        "promised_m2": {name: gains.tolist() for name, gains in gains_m2.items()},
        "done": done,
        "gain_m2": true_m2,
    }


def _against_truth(
    belief: Estimate, flat: ClothMesh, positions: Float[np.ndarray, "vertices 3"], kind: str
) -> dict[str, float | None]:
    """How wrong a belief is, by the naming that is nearest to the truth."""
    namings = [
        material_points(positions, flat.faces, where_in(flat, belief.flat, kind, signs))
        for signs in symmetries(kind)
    ]
    errors_m = [np.linalg.norm(belief.positions - points, axis=1).mean() for points in namings]
    nearest = int(np.argmin(errors_m))
    return {
        "error_mm": 1e3 * float(errors_m[nearest]),
        "in_order": in_order(belief.positions, namings[nearest], belief.flat),
    }


def fitted(rows: Sequence[dict[str, Any]], planner: str) -> str:
    """A line: slopes of the gain over the promise and over the distance off the cloth."""
    of_all: list[list[np.ndarray]] = [[], [], []]
    for row in rows:
        done = row["done"]
        promised_m2, off_m = np.array(row["promised_m2"][planner]), np.array(row["off_m"])
        each = (1e4 * np.array(row["gain_m2"]), 1e4 * promised_m2[done], off_m[done])
        for column, values in zip(of_all, each, strict=True):
            column.append(values - values.mean())
    gain, promised, off = map(np.concatenate, of_all)
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


def won(rows: Sequence[dict[str, Any]], planner: str, strip_m: float) -> list[float]:
    """The true gain [cm2] of what a planner chooses at each start."""
    gains = []
    for row in rows:
        promised_m2, off_m = np.array(row["promised_m2"][planner]), np.array(row["off_m"])
        number = preferred(promised_m2, off_m, strip_m)
        gains.append(1e4 * row["gain_m2"][row["done"].index(number)])
    return gains


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Both tables, and how wrong the beliefs were."""
    names = list(rows[0]["promised_m2"])
    lines = ["| planned from, by | per promised cm2 | per meter off, cm2 | strip, m | known |"]
    lines.append("|---" * 5 + "|")
    lines += [f"| {name} {fitted(rows, name)}" for name in names]
    head = " | ".join(f"strip {100 * strip_m:.0f} cm" for strip_m in STRIPS_M)
    lines += ["", f"| won, cm2 | {head} |", "|---" * (1 + len(STRIPS_M)) + "|"]
    for name in names:
        cells = " | ".join(_cell(won(rows, name, strip_m)) for strip_m in STRIPS_M)
        lines.append(f"| {name} | {cells} |")
    off = [1e4 * row["gain_m2"][row["done"].index(int(np.argmax(row["off_m"])))] for row in rows]
    lines.append(f"\nFarthest off the cloth: {_cell(off)}.")
    for name in rows[0]["beliefs"]:
        wrong = [row["beliefs"][name] for row in rows]
        order = 100 * np.mean([one["in_order"] for one in wrong if one["in_order"] is not None])
        error_mm = np.mean([one["error_mm"] for one in wrong])
        lines.append(f"{name}: {error_mm:.1f} mm off, layers in order {order:.0f} %.")
    return "\n".join(lines)


def _cell(gains: Sequence[float]) -> str:
    return f"{np.mean(gains):.0f} ± {np.std(gains) / len(gains) ** 0.5:.0f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the starts")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--candidates", type=int, default=100, help="actions that are judged")
    parser.add_argument("--weights", default="", help="of the network; those of the package")
    parser.add_argument("--smoke", action="store_true", help="one napkin")
    options = parser.parse_args(arguments)
    if options.starts < 1:
        parser.error(f"--starts is {options.starts}; it must be at least 1")
    robot = SimulatedRobotConfig(film=False)
    if options.smoke:
        options.kind, options.starts, robot = "towel", 1, replace(robot, episode=SMOKE)
        options.candidates = 12
    quiet_warp()
    try:
        perceptions = {
            name: perception_of(
                options.kind,
                PerceptionConfig(weights=options.weights, refined=name == "refined"),
            )
            for name in PERCEIVED
        }
    except ClothTrackError as error:
        parser.error(str(error))
    configs = {
        name: with_settings(FlattenConfig(), settings) for name, settings in PLANNERS.items()
    }
    planners = {
        name: Planner(dynamics_of(config), config.planner) for name, config in configs.items()
    }
    rows = []
    for seed in range(options.first_seed, options.first_seed + options.starts):
        folder = options.out / f"{options.kind}_{seed}"
        done = folder / "row.json"
        if not done.exists():
            folder.mkdir(parents=True, exist_ok=True)
            row = measured(
                SimulatedRobot(options.kind, seed, robot),
                seed,
                folder,
                planners,
                perceptions,
                candidates=options.candidates,
            )
            with atomic_file(done) as unfinished:
                unfinished.write_text(json.dumps(row), encoding="utf-8")
        rows.append(json.loads(done.read_text()))
    say(f"{__doc__.splitlines()[0]}\n\n{len(rows)} starts ({options.kind})\n\n{markdown(rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
