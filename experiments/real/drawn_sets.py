"""Drawn data in the layout of the real sets, for smoke runs: towels from above, rising squares."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from real.picture_scores import drawn_depth
from real.robot_clouds import NAME
from real.topdown import (
    CAMERA_HEIGHT_M,
    GARMENTS,
    LEVEL,
    LEVELS_PER_M,
    PIXEL_M,
    STICKER_INSET,
    STICKERS,
)

SIDE_M = 0.16
TILT_DEG, DISTANCE_M = 6.0, 0.6
MAP_PX = 320
LAYER_M = 0.006


def folded() -> ClothMesh:
    """Return a square towel on the table, a third of it folded over."""
    flat = garment("towel", vertex_count=400, size_m=(SIDE_M, SIDE_M))
    x, y, z = flat.vertices.astype(np.float64).T
    line = SIDE_M / 6.0
    over = x > line
    bent = np.stack([np.where(over, 2 * line - x, x), y, z + LAYER_M * (1 + over)], axis=1)
    return flat.with_vertices(bent)


def write_topdown(folder: Path) -> Path:
    """Write both sets, one picture and two pictures; returns the folder."""
    _write_garment(folder / GARMENTS)
    _write_stickers(folder / STICKERS)
    return folder


def _write_garment(folder: Path) -> None:
    turn, _ = cv2.Rodrigues(np.radians(TILT_DEG) * np.array([1.0, 0.0, 0.0]))
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn
    pose[:3, 3] = -pose[:3, 2] * DISTANCE_M
    intrinsics = {"width": 160, "height": 120, "fx": 180.0, "fy": 180.0, "cx": 79.5, "cy": 59.5}
    camera = Camera("top", **intrinsics, world_from_camera=pose)
    cloth = drawn_depth(folded(), camera)
    rays = replace(camera, world_from_camera=np.eye(4)).back_project(np.ones_like(cloth))
    table = -pose[2, 3] / (rays @ pose[2, :3]).reshape(cloth.shape)
    depth = np.where(cloth > 0, cloth, table)
    _write_picture(folder, "03", np.rint(1e3 * depth).astype(np.uint16), cloth > 0)
    cv2.imwrite(str(_new(folder / "mask" / "03.png")), 255 * (cloth > 0).astype(np.uint8))
    frames = [{"id": 3, "garment": "towel"}]
    _write_meta(folder, {"intrinsics": {**intrinsics, "depth_unit_m": 0.001}, "frames": frames})


def _write_stickers(folder: Path) -> None:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = CAMERA_HEIGHT_M
    focal, middle = CAMERA_HEIGHT_M / PIXEL_M, (MAP_PX - 1) / 2
    camera = Camera("map", MAP_PX, MAP_PX, focal, focal, middle, middle, pose)
    bent = folded()
    flat = garment("towel", vertex_count=400, size_m=(SIDE_M, SIDE_M))
    frames = []
    for name, mesh in (("square_00", flat), ("square_01", bent)):
        drawn = drawn_depth(mesh, camera)
        height_m = np.where(drawn > 0, CAMERA_HEIGHT_M - drawn, 0.0)
        level = np.where(drawn > 0, LEVEL - LEVELS_PER_M * height_m, 255)
        _write_picture(folder, name, np.clip(level, 0, 255).astype(np.uint8), drawn > 0)
        # On the two corners that are not folded over: those at the left.
        corners = mesh.vertices[np.abs(mesh.canonical[:, :2]).min(axis=1) > 0.499 * SIDE_M]
        left = corners[corners[:, 0] < -0.4 * SIDE_M].astype(np.float64)
        inset = STICKER_INSET / np.sqrt(2.0) * SIDE_M
        left[:, :2] -= inset * np.sign(left[:, :2])
        places, _ = camera.project(left)
        marks = [{"u": float(u), "v": float(v)} for u, v in places]
        frames.append({"frame": name, "cloth": "square", "corner_stickers": marks})
    _write_meta(folder, {"frames": frames})


def _write_picture(
    folder: Path,
    name: str,
    depth: UInt8[np.ndarray, "height width"] | Float[np.ndarray, "height width"],
    cloth: Bool[np.ndarray, "height width"],
) -> None:
    color = np.where(cloth[..., None], np.uint8((60, 90, 160)), np.uint8(235))
    cv2.imwrite(str(_new(folder / "depth" / f"{name}.png")), depth)
    cv2.imwrite(str(_new(folder / "color" / f"{name}.png")), color)


def _write_meta(folder: Path, meta: dict) -> None:
    _new(folder / "meta.json").write_text(json.dumps(meta), encoding="utf-8")


def _new(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


FRAMES, SQUARE_M, TABLE_M, CUT_M, STEP_M = 9, 0.2, 0.05, 0.06, 0.02
POINTS = 101
# x right is world x, y down is world -y.
POSE = [[1.0, 0.0, 0.0, 0.1], [0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, 1.0]]


def write_robot_clouds(
    folder: Path, names: Sequence[str] = ("lift_white",), *, lowest_z_m: float = CUT_M
) -> Path:
    """Write the set below `folder`, and return `folder`.

    The first square rises level by 2 cm per frame; each further one leans by one degree more. There
    are no points below `lowest_z_m`.
    """
    (folder / NAME / "sequences").mkdir(parents=True)
    corners = [[0, 0], [SQUARE_M, 0], [SQUARE_M, SQUARE_M], [0, SQUARE_M]]
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
    ticks = np.linspace(0, SQUARE_M, POINTS)
    cloud = np.stack(np.meshgrid(ticks, ticks, [height_m]), -1).reshape(-1, 3)
    return cloud + np.outer(cloud[:, 0] * np.tan(lean_rad), (0, 0, 1))


def _write_sequence(file: Path, lean_rad: float, lowest_z_m: float) -> None:
    heights = TABLE_M + STEP_M * np.arange(FRAMES)
    clouds = [cloud_at(h, lean_rad) if h >= lowest_z_m else np.zeros((0, 3)) for h in heights]
    lift = SQUARE_M * np.tan(lean_rad)
    np.savez(
        file,
        points_tenth_mm=np.rint(np.concatenate(clouds) * 1e4).astype(np.int16),
        offsets=np.cumsum([0, *map(len, clouds)]),
        gripper_m=np.stack([[SQUARE_M, SQUARE_M, height + lift] for height in heights]),
        time_s=0.1 * np.arange(FRAMES),
    )
