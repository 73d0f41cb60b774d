"""Flatten a real cloth with a Franka arm and a camera above the table (docs/flattening.md).

    python examples/flatten_with_franka.py cell.json --weights model.safetensors           # checks
    python examples/flatten_with_franka.py cell.json --weights model.safetensors --move    # moves

`cell.json` is yours: the robot's address, base_from_world (4 x 4), the workspace, the height of the
table, and of the camera intrinsics and world_from_camera. `camera_of` is where your camera's driver
comes in; here it is a RealSense.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from clothtrack.geometry.camera import Camera
from clothtrack.planning.actions import ActionSpace, Workspace
from clothtrack.planning.flattening import (
    EpisodeScene,
    FlattenConfig,
    Flattening,
    dynamics_of,
    flat_area,
)
from clothtrack.planning.franka import FrankaConfig, FrankaRobot, FrankyArm
from clothtrack.planning.perception import PerceptionConfig, perception_of
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.robot import MotionLimits, RgbdFrame
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.report.flattening_page import write_flattening_report


def camera_of(cell):
    """A function that takes a picture now: a RealSense, depth registered to colour."""
    import pyrealsense2 as rs

    told = cell["camera"]
    camera = Camera(**{**told, "world_from_camera": np.array(told["world_from_camera"])})
    pipeline, wanted = rs.pipeline(), rs.config()
    wanted.enable_stream(rs.stream.depth, camera.width, camera.height, rs.format.z16, 30)
    wanted.enable_stream(rs.stream.color, camera.width, camera.height, rs.format.rgb8, 30)
    unit = pipeline.start(wanted).get_device().first_depth_sensor().get_depth_scale()
    registered = rs.align(rs.stream.color)

    def take():
        frames = registered.process(pipeline.wait_for_frames())
        depth = np.asanyarray(frames.get_depth_frame().get_data()).astype(np.float32) * unit
        color = np.asanyarray(frames.get_color_frame().get_data()).copy()
        return RgbdFrame(0.0, camera, depth, color)

    return take


def cell_config(cell):
    """The limits and the hand-eye transform that the file states."""
    box = {name: tuple(cell["workspace"][name]) for name in ("x_m", "y_m", "z_m")}
    limits = MotionLimits(
        workspace=Workspace(**box),
        table_height_m=cell["table_height_m"],
        clearance_m=cell["clearance_m"],
        speed=cell["speed"],
    )
    return FrankaConfig(
        limits=limits,
        base_from_world=np.array(cell["base_from_world"]),
        home_m=tuple(cell["home_m"]),
    )


def flatten(robot, cell, weights, output):
    """One episode with whatever robot; its report."""
    config = robot.config
    height = cell["table_height_m"]
    cloth = ClothDescription(cell["garment"], cell.get("color"), tuple(cell["size_m"]))
    table = Table(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
    asked = FlattenConfig(
        perception=PerceptionConfig(weights=str(weights)),
        planner=PlannerConfig(space=ActionSpace(workspace=config.limits.workspace)),
    )
    flattening = Flattening(
        robot,
        EpisodeScene(cloth, table, flat_area(cloth)),
        asked,
        perception=perception_of(cloth.kind, asked.perception),
        dynamics=dynamics_of(asked),
    )
    store = flattening.run(output / "episode")
    return write_flattening_report(store, output / "report.html")


def main():
    """Read the command line, connect, flatten."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cell", type=Path)
    parser.add_argument("--weights", type=Path, required=True)
    parser.add_argument("--output", type=Path, default=Path("out/franka"))
    parser.add_argument("--move", action="store_true", help="let the arm move")
    options = parser.parse_args()
    cell = json.loads(options.cell.read_text(encoding="utf-8"))
    arm = FrankyArm(cell["address"])
    robot = FrankaRobot(arm, camera_of(cell), cell_config(cell), may_move=options.move)
    flatten(robot, cell, options.weights, options.output)


if __name__ == "__main__":
    main()
