"""Flatten a real cloth with a Franka arm and a camera above the table (docs/flattening.md).

    python examples/flatten_with_franka.py cell.json            # plans one action, moves nothing
    python examples/flatten_with_franka.py cell.json --move     # and carries it out

`cell.json` is yours: the robot's address, the limits, the height of the table, the cloth, and the
recording whose camera was calibrated (`franka_cell.json` beside this file is one to begin from).
`camera_of` is where your camera comes in; here it is a RealSense.
"""

import argparse
import json
import sys
from itertools import islice
from pathlib import Path

import numpy as np
from franka_robot import FrankaConfig, FrankaRobot, FrankyArm

from clothtrack.errors import ClothTrackError
from clothtrack.planning.action_space import ActionSpace, Workspace
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
from clothtrack.planning.flattening import EpisodeScene, Flattening, flat_area
from clothtrack.planning.perception import PerceptionConfig, perception_of
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.robots.dry_run import DryRunRobot
from clothtrack.planning.robots.robot import MotionLimits, RgbdFrame
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.recordings.store import read_recording
from clothtrack.report.flattening_page import write_flattening_report
from clothtrack_capture import open_realsense

SETTLING_FRAMES = 5
"""Pictures that are thrown away before one is kept: the first may be from before the motion."""


def camera_of(cell):
    """A function that takes a picture now; where the camera is, the calibrated recording says."""
    camera = read_recording(Path(cell["recording"])).cameras[0]
    source = open_realsense(width=camera.width, height=camera.height)

    def take():
        *_, shown = islice(source.frames(), SETTLING_FRAMES)
        return RgbdFrame(0.0, camera, shown.depth_m, shown.color)

    return take


def cell_config(cell, raised_m=0.0):
    """The limits and the hand-eye transform that the file states, the arm so much higher [m].

    Higher means: told to go to a point of the table, the arm goes to a point above it.
    """
    box = {name: tuple(cell["workspace"][name]) for name in ("x_m", "y_m", "z_m")}
    box["z_m"] = (box["z_m"][0], box["z_m"][1] - raised_m)
    limits = MotionLimits(
        workspace=Workspace(**box),
        table_height_m=cell["table_height_m"],
        clearance_m=cell["clearance_m"],
        speed=cell["speed"],
    )
    base_from_world = np.array(cell["base_from_world"], dtype=np.float64)
    base_from_world[:3, 3] += raised_m * base_from_world[:3, 2]
    x, y, z = cell["home_m"]
    return FrankaConfig(limits=limits, base_from_world=base_from_world, home_m=(x, y, z - raised_m))


class Rehearsal(DryRunRobot):
    """Writes down what the arm would do, and asks the arm whether it might."""

    def __init__(self, robot, folder):
        super().__init__(robot.observe, folder, limits=robot.config.limits)
        self._robot = robot

    def check(self, action):
        return self._robot.check(action)


def flatten(robot, cell, folder, *, limits, actions=1, weights=""):
    """One episode with whatever robot; it is kept in a folder that must be new."""
    if folder.exists():
        # An episode would go on from its last picture, and the cloth may have been moved since.
        raise ClothTrackError(f"{folder}: there is an episode already; name another --output")
    cloth = ClothDescription(cell["garment"], cell.get("color"), tuple(cell["size_m"]))
    table = Table(np.array([0.0, 0.0, cell["table_height_m"]]), np.array([0.0, 0.0, 1.0]))
    asked = FlattenConfig(
        perception=PerceptionConfig(weights=str(weights)),
        planner=PlannerConfig(space=ActionSpace(workspace=limits.workspace)),
        actions=actions,
    )
    flattening = Flattening(
        robot,
        EpisodeScene(cloth, table, flat_area(cloth)),
        asked,
        perception=perception_of(cloth.kind, asked.perception),
        dynamics=dynamics_of(asked),
    )
    return flattening.run(folder / "episode")


def main(arguments=None):
    """Read the command line, connect, flatten."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cell", type=Path)
    parser.add_argument("--weights", default="", help="those that come along by default")
    parser.add_argument("--output", type=Path, default=Path("out/franka"))
    parser.add_argument("--move", action="store_true", help="let the arm move")
    parser.add_argument("--actions", type=int, default=1, help="most of them; with --move")
    parser.add_argument(
        "--raise", dest="raised_m", type=float, default=0.0, metavar="METERS",
        help="everything so much higher: a first try in the air",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    if options.raised_m < 0.0:
        parser.error("--raise is a height above the table, 0 or more")
    cell = json.loads(options.cell.read_text(encoding="utf-8"))
    try:
        config = cell_config(cell, options.raised_m)
        take = camera_of(cell)
        robot = FrankaRobot(FrankyArm(cell["address"]), take, config, may_move=options.move)
        _, tips = robot.measured()
        print("the finger tips are at", np.round(tips, 3).tolist(), "m in the world: measure!")
        who = robot if options.move else Rehearsal(robot, options.output)
        store = flatten(
            who, cell, options.output, limits=config.limits, weights=options.weights,
            actions=options.actions if options.move else 1,
        )  # fmt: skip
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    page = write_flattening_report(store, options.output / "report.html")
    plans = sorted(options.output.glob("action_*.png"))
    print(store.document["status"], page, *plans)
    if not options.move and plans:
        print("nothing has moved; with --move (and another --output) it would")
    return 0


if __name__ == "__main__":
    sys.exit(main())
