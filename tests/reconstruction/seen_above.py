"""Cloths folded by hand, and what a camera straight above sees of them."""

import numpy as np

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.recordings.recording import Table

PIXELS = 128
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
LAYER_M = 0.003


def camera_above(height_m=1.0, width_m=0.5, pixels=PIXELS):
    """Looks straight down on the origin and shows so much of the table."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = height_m
    focal = pixels * height_m / width_m
    middle = 0.5 * (pixels - 1)
    return Camera("above", pixels, pixels, focal, focal, middle, middle, pose)


def depth_of(vertices, faces, camera):
    """Depth [m]; 0 where there is no cloth."""
    depth = Rasterizer(faces, camera).render(vertices).depth
    return np.where(np.isfinite(depth), depth, 0.0)


def seen_from_above(vertices, faces, camera=None):
    """The cloth as a camera above sees it, free to lie where it was seen."""
    camera = camera or camera_above()
    depth = depth_of(vertices, faces, camera)
    return SeenCloth(camera, depth, depth > 0, 0.0)


def picture_of(vertices, faces):
    """The same as a sensor of more pixels measures it, with the table around."""
    camera = camera_above(width_m=0.7, pixels=400)
    depth = depth_of(vertices, faces, camera)
    return DepthInput(np.where(depth > 0, depth, 1.0), depth > 0, camera, TABLE, "towel")


def half_folded(mesh, *, at_m=0.0, layer_m=LAYER_M):
    """What lies beyond x = at_m is laid back over the rest, a layer higher."""
    x, y, _ = np.asarray(mesh.vertices, np.float64).T
    over = x > at_m
    return np.column_stack([np.where(over, 2.0 * at_m - x, x), y, layer_m * (1.0 + over)])


def waved(mesh, seed, fold=(0.1, 0.4), per_m=(10, 20), height_m=0.015):
    """The garment turned, in waves, with one side laid over the rest."""
    rng = np.random.default_rng(seed)
    x, y, z = np.asarray(mesh.vertices, np.float64).T
    line = x.min() + rng.uniform(*fold) * np.ptp(x)
    over = x < line
    x, z = np.where(over, 2 * line - x, x), z - z.min() + 0.012 * over
    first, second = rng.uniform(*per_m, 2)
    z = z + height_m * (1 + np.sin(first * x) * np.cos(second * y)) + 0.002
    turn = rng.uniform(-np.pi, np.pi)
    level = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    return np.column_stack([*level, z]).astype(np.float32)
