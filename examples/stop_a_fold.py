"""A robot that watches the live mesh, and stops a fold when the cloth has slipped (docs/live.md).

    python examples/stop_a_fold.py                    # the cloth slips at 40 % of the way
    python examples/stop_a_fold.py --slips-at 1       # it does not: the fold is finished

The robot, its camera and the cloth are simulated in MuJoCo (`make EXTRAS=lab install`). Nobody
tells the tracker that the cloth slips: its dynamics go on carrying it, the pictures do not agree,
and the error that is to be expected of the mesh grows.
"""

import argparse
import sys
from dataclasses import dataclass

import numpy as np

import clothtrack as ct
from clothtrack.planning.action_space import PickPlace
from clothtrack_lab.world.simulated_robot import SimulatedRobot

MOST_ERROR_M = 0.012
"""The robot stops when the mean expected error of a vertex is larger than this [m]."""


@dataclass
class Fold:
    """What became of a fold.

    Attributes:
        way: share of the way from pick to place that the tip has gone.
        reason: why it stopped; empty when it was finished.
        expected_error_m: largest mean expected error of a vertex while the robot carried [m].
    """

    way: float = 0.0
    reason: str = ""
    expected_error_m: float = 0.0


def fold(kind: str, seed: int, slips_at: float) -> Fold:
    """Fold the outermost point of a flat cloth over its middle, and watch it.

    Args:
        kind: "towel" or "tshirt".
        seed: of cloth, camera and noise.
        slips_at: share of the way after which the cloth slips out of the gripper; 1: never.
    """
    robot = SimulatedRobot(kind, seed)
    shown, done = robot.observe(), Fold()
    tracker = ct.LiveTracker(
        robot.cloth, shown.camera, table=robot.table, settings=["search.method=none"]
    )
    flat = tracker.update(shown.time_s, shown.depth_m, shown.color).positions.astype(np.float64)
    middle = flat.mean(axis=0)
    outermost = flat[np.argmax(np.linalg.norm(flat - middle, axis=1))]
    pick, place = 0.95 * outermost + 0.05 * middle, 1.9 * middle - 0.9 * outermost
    place[2] = pick[2]

    def stop(shown, tip, closed):
        """Say why the robot is to stop, or nothing."""
        hand = {"gripper": (tip, closed)}
        state = tracker.update(shown.time_s, shown.depth_m, shown.color, picker=hand)
        if not closed:
            return ""
        done.way = float(np.linalg.norm((tip - pick)[:2]) / np.linalg.norm((place - pick)[:2]))
        error_m = float(state.expected_error_m.mean())
        done.expected_error_m = max(done.expected_error_m, error_m)
        return f"an error of {1e3 * error_m:.0f} mm" if error_m > MOST_ERROR_M else ""

    action = PickPlace(pick, place, 0.08)
    done.reason = robot.execute(action, stop=stop, slips_at=slips_at).error
    tracker.close()
    return done


def main() -> None:
    """Fold one cloth, and say how it went."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=("towel", "tshirt"), default="towel")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--slips-at", type=float, default=0.4, help="share of the way; 1: never")
    options = parser.parse_args()
    try:
        done = fold(options.kind, options.seed, options.slips_at)
    except ct.ClothTrackError as error:
        parser.error(str(error))
    what = f"stopped, the mesh expects {done.reason}" if done.reason else "finished"
    sys.stdout.write(
        f"{what}, after {100 * done.way:.0f} % of the way "
        f"(largest expected error {1e3 * done.expected_error_m:.1f} mm)\n"
    )


if __name__ == "__main__":
    main()
