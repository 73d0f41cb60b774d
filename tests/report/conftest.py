"""A sheet that waves and folds, seen by two cameras or as clouds only; small enough for tests."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.recordings.recording import (
    ClothDescription,
    Frame,
    PickAndPlace,
    PickerPath,
    Recording,
    Table,
)
from clothtrack.report.viewpoint import look_at
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

FRAMES, SIDE = 6, 13


def sheet() -> ClothMesh:
    """A flat square of 0.3 m whose front faces look up."""
    u = np.linspace(-0.15, 0.15, SIDE)
    x, y = np.meshgrid(u, u)
    first = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)[:-1, :-1].ravel()
    faces = np.concatenate(
        [
            np.stack([first, first + 1, first + SIDE], axis=1),
            np.stack([first + 1, first + SIDE + 1, first + SIDE], axis=1),
        ]
    )
    return ClothMesh(np.stack([x.ravel(), y.ravel(), np.zeros(SIDE * SIDE)], axis=1), faces)


def folded(rest: ClothMesh, share: float) -> np.ndarray:
    """The right half turned about the y axis by `share` of half a turn; waves on it."""
    vertices = rest.vertices.copy()
    right = vertices[:, 0] > 0
    reach, angle = vertices[right, 0].copy(), np.pi * share
    vertices[right, 0] = reach * np.cos(angle)
    vertices[right, 2] = reach * np.sin(angle) + 0.004
    vertices[:, 2] += 0.01 + 0.004 * np.sin(25 * vertices[:, 1])
    return vertices


def _action(first: int, last: int, positions: np.ndarray, seed: int) -> TrackedAction:
    generator = np.random.default_rng(seed)
    candidates = np.array([[1e-5, 0.2], [1e-5, 0.5], [1e-4, 0.2], [1e-4, 0.5]])
    scores = generator.uniform(1e-5, 1e-4, len(candidates))
    best = int(scores.argmin())
    names = ("stretch_compliance", "table_friction")
    return TrackedAction(
        first_frame=first,
        last_frame=last,
        positions_before_final_alignment=positions + np.float32(0.002),
        positions_after_final_alignment=positions,
        final_alignment_losses=np.array([3e-5, 1e-5]),
        parameters=dict(zip(names, candidates[best].tolist(), strict=True)),
        calibration=Calibration("grid", names, candidates, scores, best, 4.0),
        held_vertices={"gripper": (SIDE - 1,)},
    )


def _steps() -> StepRecords:
    blank = StepRecords.empty(FRAMES)
    before = np.linspace(1e-5, 4e-5, FRAMES).astype(np.float32)
    before[0] = np.nan
    gave_up = np.zeros(FRAMES, dtype=bool)
    gave_up[3] = True
    return replace(
        blank,
        loss_before=before,
        loss_after=0.4 * before,
        trials=np.arange(FRAMES, dtype=np.int32),
        gave_up=gave_up,
    )


@pytest.fixture(scope="session")
def tracked() -> TrackedTrajectory:
    """A sheet folded in half in six frames; what the fold covers is hidden."""
    rest = sheet()
    shares = np.linspace(0.0, 0.96, FRAMES)
    positions = np.stack([folded(rest, share) for share in shares]).astype(np.float32)
    visible = np.ones(positions.shape[:2], dtype=bool)
    visible[shares > 0.6] = rest.vertices[:, 0] > -0.005
    return TrackedTrajectory(
        name="fold <in> half",
        mesh=rest,
        frames=np.arange(FRAMES, dtype=np.int32),
        time_s=np.arange(FRAMES) / 10,
        positions=positions,
        visible=visible,
        actions=(_action(0, 2, positions[2], 0), _action(3, 5, positions[5], 1)),
        steps=_steps(),
        config={"seed": 0, "alignment": {"iterations": 200}},
        provenance={"commit": "0000000"},
    )


@pytest.fixture(scope="session")
def one_frame(tracked: TrackedTrajectory) -> TrackedTrajectory:
    """The end of the first action and nothing else."""
    return replace(
        tracked,
        frames=tracked.frames[2:3],
        time_s=tracked.time_s[2:3],
        positions=tracked.positions[2:3],
        visible=tracked.visible[2:3],
        steps=StepRecords(**{name: each[2:3] for name, each in vars(tracked.steps).items()}),
        actions=(replace(tracked.actions[0], first_frame=2),),
    )


def _write_views(
    folder: Path, camera: Camera, step: int, vertices: np.ndarray, faces: np.ndarray
) -> dict[str, dict[str, Path]]:
    buffer = Rasterizer(faces, camera).render(vertices)
    cloth = buffer.faces >= 0
    color = np.where(cloth[..., None], (40, 60, 190), (150, 160, 165)).astype(np.uint8)
    depth = np.where(cloth, 1000 * np.where(cloth, buffer.depth, 0.0), 0.0).astype(np.uint16)
    pictures = {"color": color, "depth": depth, "mask": cloth.astype(np.uint8) * 255}
    paths = {}
    for kind, picture in pictures.items():
        path = folder / f"{kind}_{camera.name}_{step}.png"
        cv2.imwrite(str(path), picture)
        paths[kind] = {camera.name: path}
    return paths


def _recording(folder: Path, cameras: tuple[Camera, ...], frames: tuple[Frame, ...]) -> Recording:
    times = np.arange(FRAMES) / 10
    tips = np.stack([folded(sheet(), share)[SIDE - 1] for share in np.linspace(0, 0.96, FRAMES)])
    closed = np.array([False, True, True, True, True, False])
    return Recording(
        folder=folder,
        cameras=cameras,
        depth_units_m={camera.name: 0.001 for camera in cameras},
        frames=frames,
        actions=(PickAndPlace(0, 2, ("gripper",)), PickAndPlace(3, 5, ("gripper",))),
        picker_paths={"gripper": PickerPath(times, tips, closed)},
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])),
        cloth=ClothDescription("towel", "red", (0.3, 0.3), sheet()),
        provenance={"maker": "a test"},
    )


@pytest.fixture(scope="session")
def two_cameras(tmp_path_factory: pytest.TempPathFactory, tracked: TrackedTrajectory) -> Recording:
    """Color, depth and mask from above and from the side."""
    folder = tmp_path_factory.mktemp("two_cameras")
    cameras = (
        look_at(np.array([0.0, 0.0, 0.8]), np.zeros(3), width=160, height=120, name="top"),
        look_at(np.array([0.5, -0.5, 0.5]), np.zeros(3), width=160, height=120, name="side"),
    )
    frames = []
    for step, vertices in enumerate(tracked.positions):
        kinds: dict[str, dict[str, Path]] = {"color": {}, "depth": {}, "mask": {}}
        for camera in cameras:
            written = _write_views(folder, camera, step, vertices, tracked.mesh.faces)
            for kind, paths in written.items():
                kinds[kind].update(paths)
        frames.append(Frame(step, step / 10, **kinds))
    return _recording(folder, cameras, tuple(frames))


@pytest.fixture(scope="session")
def clouds_only(tmp_path_factory: pytest.TempPathFactory, tracked: TrackedTrajectory) -> Recording:
    """No camera at all: a point cloud for each frame."""
    folder = tmp_path_factory.mktemp("clouds_only")
    weights = np.random.default_rng(0).dirichlet((1, 1, 1), (len(tracked.mesh.faces), 20))
    frames = []
    for step, vertices in enumerate(tracked.positions):
        corners = vertices[tracked.mesh.faces]
        points = np.einsum("fsk,fkd->fsd", weights, corners).reshape(-1, 3)
        path = folder / f"{step}.npz"
        np.savez(path, points=points)
        frames.append(Frame(step, step / 10, cloud=path))
    return _recording(folder, (), tuple(frames))
