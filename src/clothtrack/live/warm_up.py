"""Warm-up on a small cloth, so that the first picture loads and compiles nothing."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.tracking.configuration import InitialStateConfig, ModeName
from clothtrack.tracking.configuration import mode as settings_of_mode
from clothtrack.tracking.search import SearchConfig

_HEIGHT_M = 0.5
_RESTING_M = 0.0015


@cache
def warm_up(make: Callable[..., Any], mode: ModeName, color: bool, device: str) -> None:
    """Track a lifted towel corner with every step of a mode, once per process."""
    towel = garment("towel", vertex_count=150, size_m=(0.15, 0.15))
    vertices = towel.vertices + (0.0, 0.0, _RESTING_M - towel.vertices[:, 2].min())
    towel = towel.with_vertices(vertices - np.append(vertices[:, :2].mean(axis=0), 0.0))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = _HEIGHT_M
    camera = Camera("warm_up", 160, 120, 150.0, 150.0, 79.5, 59.5, pose)
    drawn = Rasterizer(towel.faces, camera, device=device).render(towel.vertices)
    mask = drawn.faces >= 0
    depth = np.where(mask, drawn.depth, _HEIGHT_M).astype(np.float32)
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    config = replace(
        settings_of_mode(mode), color=color, initial_state=InitialStateConfig(),
        search=SearchConfig(method="none"),
    )  # fmt: skip
    tracker = make(
        ClothDescription("towel", template=towel), camera,
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])), config=config, device=device,
        force=True, warm=False,
    )  # fmt: skip
    corner = towel.vertices[np.argmax(towel.vertices[:, :2].sum(axis=1))]
    for step in range(4):
        tip = corner + (-0.005 * step, -0.005 * step, 0.005 * step)
        if step == 3:
            tracker.end_action()
        tracker.update(0.05 * step, depth, noise, mask, {"tip": (tip, 0 < step < 3)})
    tracker.tracked()
