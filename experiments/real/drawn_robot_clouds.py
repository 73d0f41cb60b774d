"""Synthetic data in the layout of `real/robot_clouds.py`: rising squares seen from above."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from real.robot_clouds import NAME

FRAMES, SIDE_M, TABLE_M, CUT_M, STEP_M = 9, 0.2, 0.05, 0.06, 0.02
POINTS = 101
# x right is world x, y down is world -y.
POSE = [[1.0, 0.0, 0.0, 0.1], [0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, 1.0]]


def write(
    folder: Path, names: Sequence[str] = ("lift_white",), *, lowest_z_m: float = CUT_M
) -> Path:
    """Write the set below `folder`, and return `folder`.

    The first square rises level by 2 cm per frame; each further one leans by one degree more. There
    are no points below `lowest_z_m`.
    """
    (folder / NAME / "sequences").mkdir(parents=True)
    corners = [[0, 0], [SIDE_M, 0], [SIDE_M, SIDE_M], [0, SIDE_M]]
    corners = [[*corner, TABLE_M] for corner in corners]
    camera = {"fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480}
    start = {"table_height_m": TABLE_M, "corners_m": corners, "picked_corner_m": corners[2]}
    meta = {
        "cameras": {"overhead": camera | {"camera_to_robot_3x4": POSE}},
        "initial_cloth": {"lift": start},
        "sequences": [{"name": name, "task": "lift", "lowest_z_m": lowest_z_m} for name in names],
    }
    (folder / NAME / "meta.json").write_text(json.dumps(meta))
    for number, name in enumerate(names):
        _write_sequence(folder / NAME / "sequences" / f"{name}.npz", np.radians(number), lowest_z_m)
    return folder


def cloud_at(height_m: float, lean_rad: float = 0.0) -> Float[np.ndarray, "points 3"]:
    """Return points of the square at a height [m]."""
    ticks = np.linspace(0, SIDE_M, POINTS)
    cloud = np.stack(np.meshgrid(ticks, ticks, [height_m]), -1).reshape(-1, 3)
    return cloud + np.outer(cloud[:, 0] * np.tan(lean_rad), (0, 0, 1))


def _write_sequence(file: Path, lean_rad: float, lowest_z_m: float) -> None:
    heights = TABLE_M + STEP_M * np.arange(FRAMES)
    clouds = [cloud_at(h, lean_rad) if h >= lowest_z_m else np.zeros((0, 3)) for h in heights]
    lift = SIDE_M * np.tan(lean_rad)
    np.savez(
        file,
        points_tenth_mm=np.rint(np.concatenate(clouds) * 1e4).astype(np.int16),
        offsets=np.cumsum([0, *map(len, clouds)]),
        gripper_m=np.stack([[SIDE_M, SIDE_M, height + lift] for height in heights]),
        time_s=0.1 * np.arange(FRAMES),
    )
