"""Measure planning choices: the true gain of each action that a planner would choose.

Actions of a start are judged by the planner with every belief (`PERCEIVED`, either order of the
layers, and the truth). Those that it would choose with any of them, with a strip of any width
(`planner.strip_m`), are carried out in the simulated world, which goes back to the start before
each; the one placed farthest off the cloth and two at random, too. So beliefs are compared on the
same starts, without episodes.

    python experiments planning_choices --out OUT --kind tshirt --starts 20 [--weights TOKENS]
    python experiments planning_choices --out OUT --kind tshirt --starts 20 --episodes FOLDER

A third of the starts are dropped cloth, the others have been pulled outwards once or twice. With
`--episodes`, where a method's episodes lie (FOLDER/worlds, as `flattening` keeps them), they are
cloth that a plan has come to: that of every third action. Starts that are finished are kept. The
gain is fitted to the predicted gain and the distance off the cloth, start by start. The slope over
this distance divided by the slope over the predicted gain is the width of a strip.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from clothtrack.evaluation.truth import material_points
from clothtrack.files.atomic_write import atomic_file
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import (
    ActionSpace,
    off_cloth,
    pick_weights,
    sample_actions,
)
from clothtrack.planning.episode_store import write_step
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
from clothtrack.planning.perception import Estimate, Perception, PerceptionConfig, perception_of
from clothtrack.planning.planner import Hypothesis, Planner, ranked
from clothtrack.planning.seen import seen_cloth
from clothtrack.reconstruction.first_mesh import symmetries
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.flex import Fabric
from clothtrack_lab.world.simulated_robot import SimulatedRobot, SimulatedRobotConfig

FIRST_SEED = 9100
"""Of the starts; episodes begin at others."""

STRIPS_M = (0.0, 0.03, 0.09)
SMOKE = replace(SMALL_WORLD, fabric=Fabric())

PERCEIVED = ("refined", "laid")
"""The network's mesh, and the same before it is refined. Beside them, either order of its layers is
believed (the default), and the truth."""

EVERY = 3
"""Actions of an episode from one start to the next."""


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


def looked(robot: SimulatedRobot, folder: Path) -> Recording:
    """Take a picture of the cloth, without any action."""
    return write_step(folder, [robot.observe()], cloth=robot.cloth, table=robot.table)


Start = tuple[str, SimulatedRobot, Callable[[Path], None]]
"""Its name, its robot, and what brings its cloth there; that may write into a folder."""


def fresh_starts(
    kind: str, seeds: Iterable[int], config: SimulatedRobotConfig, space: ActionSpace
) -> Iterator[Start]:
    """Yield dropped cloth, of every three twice as often pulled outwards."""
    for seed in seeds:
        robot = SimulatedRobot(kind, seed, config)

        def begin(folder: Path, robot: SimulatedRobot = robot, seed: int = seed) -> None:
            robot.crumple()
            rng = np.random.default_rng([seed, 0xC401CE])
            for number in range(seed % 3):
                shown = looked(robot, folder / f"before{number}")
                seen = seen_cloth(shown, observe(shown, shown.frames[-1]))
                tried = sample_actions(seen, 100, space, rng)
                robot.execute(tried[int(np.argmax(off_cloth(seen, tried)))])

        yield f"{kind}_{seed}", robot, begin


def starts_of_episodes(
    kind: str, episodes: Path, count: int, config: SimulatedRobotConfig
) -> Iterator[Start]:
    """Yield the cloth after every third action of a method's episodes, one of each in turn."""
    worlds = [
        (int(path.stem), path.parent.name, path)
        for path in episodes.glob(f"worlds/{kind}_*/*.npz")
        if int(path.stem) % EVERY == 0
        and int(path.stem) > 0
        # Not those of one garment, KIND_gNNNN_SEED: their robot is another.
        and path.parent.name.removeprefix(f"{kind}_").isdigit()
    ]
    for action, label, path in sorted(worlds)[:count]:
        robot = SimulatedRobot(kind, int(label.rpartition("_")[2]), config)

        def begin(folder: Path, robot: SimulatedRobot = robot, path: Path = path) -> None:
            del folder
            robot.restore(path)

        yield f"{label}_{action}", robot, begin


def measured(
    name: str,
    robot: SimulatedRobot,
    folder: Path,
    planner: Planner,
    perceptions: Mapping[str, Perception],
    *,
    candidates: int,
) -> dict[str, Any]:
    """Return predicted and true gains of the actions that would be chosen now."""
    rng = np.random.default_rng([*name.encode()])
    space = planner.config.space
    shown = looked(robot, folder / "shown")
    seen = seen_cloth(shown, observe(shown, shown.frames[-1]))
    found = {name: each.perceive(shown) for name, each in perceptions.items()}
    flat, positions = robot.true_cloth()
    found["truth"] = Estimate(flat, positions, "control: truth")
    beliefs = {each: Hypothesis(one.flat, one.positions, robot.kind) for each, one in found.items()}
    refined = beliefs["refined"]
    weights = pick_weights(seen.cloud, refined.flat, refined.positions)
    tried = sample_actions(seen, candidates, space, rng, weights=weights)
    off_m = off_cloth(seen, tried)
    gains_m2 = {one: planner.gains(belief, seen, tried) for one, belief in beliefs.items()}
    gains_m2["either order"] = gains_m2["refined"]
    if (opposite := found["refined"].opposite) is not None:
        turned = planner.gains(replace(refined, positions=opposite), seen, tried)
        gains_m2["either order"] = (gains_m2["refined"] + turned) / 2.0
    done = chosen(gains_m2, off_m, rng)
    before_m2 = projected_area(positions, flat.faces)
    robot.save(folder / "world.npz")
    true_m2 = []
    for number in done:
        robot.restore(folder / "world.npz")
        robot.execute(tried[number])
        true_m2.append(projected_area(robot.true_cloth()[1], flat.faces) - before_m2)
    return {
        "start": name,
        "expected_error_m": found["refined"].expected_error_m,
        "beliefs": {
            each: _against_truth(found[each], flat, positions, robot.kind) for each in perceptions
        },
        "coverage": before_m2 / projected_area(flat.vertices, flat.faces),
        "actions": [action.as_dict() for action in tried],
        "off_m": off_m.tolist(),
        "promised_m2": {one: gains.tolist() for one, gains in gains_m2.items()},
        "done": done,
        "gain_m2": true_m2,
    }


def _against_truth(
    belief: Estimate, flat: ClothMesh, positions: Float[np.ndarray, "vertices 3"], kind: str
) -> dict[str, float | None]:
    """Return the error of a belief under the symmetry nearest to the truth."""
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
    """Return a line: slopes of the gain over predicted gain and distance off the cloth."""
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


def won(rows: Sequence[dict[str, Any]], belief: str, strip_m: float) -> list[float]:
    """Return what was won at each start from a belief with a strip of this width [cm2]."""
    gains = []
    for row in rows:
        promised_m2, off_m = np.array(row["promised_m2"][belief]), np.array(row["off_m"])
        number = preferred(promised_m2, off_m, strip_m)
        gains.append(1e4 * row["gain_m2"][row["done"].index(number)])
    return gains


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Return both tables, and how wrong the beliefs were."""
    names = list(rows[0]["promised_m2"])
    lines = ["| planned from | true per predicted cm2 | per meter off, cm2 | strip, m | known |"]
    lines.append("|---" * 5 + "|")
    lines += [f"| {name} {fitted(rows, name)}" for name in names]
    head = " | ".join(f"strip {100 * strip_m:.0f} cm" for strip_m in STRIPS_M)
    lines += ["", f"| true gain, cm2 | {head} |", "|---" * (1 + len(STRIPS_M)) + "|"]
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
    parser.add_argument("--episodes", type=Path, help="start where these have come to")
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
    config = FlattenConfig()
    planner = Planner(dynamics_of(config), config.planner)
    seeds = range(options.first_seed, options.first_seed + options.starts)
    starts = (
        fresh_starts(options.kind, seeds, robot, planner.config.space)
        if options.episodes is None
        else starts_of_episodes(options.kind, options.episodes, options.starts, robot)
    )
    rows = []
    for name, one, begin in starts:
        folder = options.out / name
        done = folder / "row.json"
        if not done.exists():
            folder.mkdir(parents=True, exist_ok=True)
            begin(folder)
            row = measured(name, one, folder, planner, perceptions, candidates=options.candidates)
            with atomic_file(done) as unfinished:
                unfinished.write_text(json.dumps(row), encoding="utf-8")
        rows.append(json.loads(done.read_text()))
    if not rows:
        parser.error(f"{options.episodes}: no worlds/{options.kind}_*/*.npz of a finished action")
    say(f"{__doc__.splitlines()[0]}\n\n{len(rows)} starts ({options.kind})\n\n{markdown(rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
