"""tshirt-pair-rgbd: one large step of a real T-shirt that two hands carry sideways.

The set has two RGB-D frames, the shirt's mask in the first, and the true motion of its pixels
between them, which only the scorer reads. The mesh is the visible front of the shirt in the first
frame. The camera was held by hand and looks down by 10 degrees; the wall behind defines the
vertical.
"""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.colors import learned_set
from clothtrack.recordings.recording import ClothDescription, PickerPath
from clothtrack.recordings.segmentation import ColorSegmenter, main_components
from clothtrack.recordings.store import RecordingWriter
from real.hanging_cloth import read_picture
from real.upright import level_camera

NAME = "tshirt-pair-rgbd"
CAMERA = "camera"
FRAME_RATE_HZ = 30.0
GRID_PIXELS = 4
LONGEST_EDGE = 2.0
GRIP_RADIUS_M = 0.04
"""Half the width of a fist [m]."""
WALL_M = 0.02
"""Thickness of what counts as one wall [m]: depth at 2 m is that coarse."""


@dataclass(frozen=True, eq=False)
class TShirtScore:
    """How well the mesh carried the shirt's pixels from the first frame to the second.

    Attributes:
        end_point_error_m: distance of each carried pixel from where it really went [m].
        off_mesh_m: distance of each pixel from the first mesh [m].
    """

    end_point_error_m: Float[np.ndarray, " pixels"]
    off_mesh_m: Float[np.ndarray, " pixels"]

    def summary(self) -> dict[str, float]:
        """Return the figures that the set's targets name."""
        return {
            "end_point_error_mm": float(self.end_point_error_m.mean() * 1e3),
            "median_mm": float(np.median(self.end_point_error_m) * 1e3),
            "p95_mm": float(np.percentile(self.end_point_error_m, 95) * 1e3),
            "pixels": len(self.end_point_error_m),
        }


def frame_numbers(folder: Path) -> tuple[int, int]:
    """Return the numbers of both frames, from the name of the file with the motion."""
    for file in sorted(folder.glob("flow_*_to_*.npz")):
        first, second = re.findall(r"\d+", file.stem)
        return int(first), int(second)
    raise InvalidRecordingError(f"{folder}: no flow_A_to_B.npz; the set needs its true motion")


def front_mesh(folder: Path) -> ClothMesh:
    """Return the first frame's masked depth as a mesh on the image grid, in the world [m].

    One vertex every 4 pixels (about 9 mm); triangles with an edge twice as long as usual are cut,
    and the largest piece is kept.
    """
    camera = standing_camera(folder)
    first, _ = frame_numbers(folder)
    mask = _first_mask(folder)
    depth = np.where(mask, _depth(folder, first), 0.0)
    depth = cv2.medianBlur(depth.astype(np.float32), 5)
    depth[cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0] = 0.0
    # Back-projection goes row by row, so the n-th measured pixel is the n-th point.
    grid = np.zeros(mask.shape, dtype=bool)
    grid[::GRID_PIXELS, ::GRID_PIXELS] = True
    points = camera.back_project(depth, grid)
    measured = (depth > 0)[::GRID_PIXELS, ::GRID_PIXELS]
    index = np.full(measured.shape, -1)
    index[measured] = np.arange(len(points))
    faces = _grid_faces(index)
    corners = points[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    spacing = GRID_PIXELS * np.median(depth[depth > 0]) / camera.fx
    return _largest_piece(points, faces[edges.max(axis=1) < LONGEST_EDGE * spacing * np.sqrt(2.0)])


def convert(folder: Path, output: Path, *, frames: int | None = None) -> Path:
    """Write the pair as a recording of two frames and one action, and return its folder."""
    del frames
    camera, numbers, mesh = standing_camera(folder), frame_numbers(folder), front_mesh(folder)
    times = np.array([0.0, (numbers[1] - numbers[0]) / FRAME_RATE_HZ])
    grips = json.loads((folder / "grips.json").read_text())
    paths = {
        f"hand{k}": PickerPath(
            times, _to_world(camera, np.array([g["start_m"], g["end_m"]])), np.ones(2, dtype=bool)
        )
        for k, g in enumerate(grips)
    }
    held = {name: _held(mesh, path.positions[0]) for name, path in paths.items()}
    with RecordingWriter(
        output,
        cameras=(camera,),
        depth_units_m={CAMERA: 0.001},
        table=None,
        cloth=ClothDescription(kind="other", template=mesh, held_vertices=held),
        provenance={"source": NAME, "frame_numbers": list(numbers)},
    ) as writer:
        for number, time_s, mask in zip(numbers, times, _masks(folder, camera), strict=True):
            writer.add_frame(
                float(time_s),
                color={CAMERA: read_picture(folder / f"color_{number:03d}.png")},
                depth={CAMERA: _depth(folder, number)},
                mask={CAMERA: mask},
            )
        for name, path in paths.items():
            writer.set_picker_path(name, path)
        writer.add_action(0, 1, tuple(paths))
    return output


def score(
    positions: Float[np.ndarray, "frames vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    folder: Path,
) -> TShirtScore:
    """Score two positions of a mesh, at the first and at the second frame [m], world frame.

    Every masked pixel whose motion is known starts on the measured surface; the closest point of
    the first mesh carries it. The error is that of the motion, so that the distance to the first
    mesh does not count twice.
    """
    points, motion = true_motion(folder)
    face, weights = closest_on_mesh(points, np.asarray(positions[0], np.float64), faces)
    start, end = (
        np.einsum("pc,pcd->pd", weights, np.asarray(each, np.float64)[faces[face]])
        for each in (positions[0], positions[-1])
    )
    return TShirtScore(
        np.linalg.norm(end - start - motion, axis=1), np.linalg.norm(start - points, axis=1)
    )


def true_motion(
    folder: Path,
) -> tuple[Float[np.ndarray, "pixels 3"], Float[np.ndarray, "pixels 3"]]:
    """Return the shirt's points in the first frame and their motion [m], world frame."""
    camera = standing_camera(folder)
    first, second = frame_numbers(folder)
    with np.load(folder / f"flow_{first:03d}_to_{second:03d}.npz") as stored:
        columns, rows = stored["u"].astype(int), stored["v"].astype(int)
        motion = _to_world(camera, stored["scene_flow_m"])
    z = _depth(folder, first)[rows, columns].astype(np.float64)
    local = [(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z]
    chosen = _first_mask(folder)[rows, columns] & (z > 0)
    return _to_world(camera, np.stack(local, axis=1))[chosen], motion[chosen]


def standing_camera(folder: Path) -> Camera:
    """Return the camera in a world whose z axis lies in the wall behind the shirt.

    The turn is the smallest that makes the wall upright, so that a frontal wall turns nothing. If
    there is no wall (less than a third of the background, or leaning by 30 degrees), the camera
    stays level.
    """
    camera = level_camera(folder / "intrinsics.json", CAMERA)
    depth = _depth(folder, frame_numbers(folder)[0])
    background = camera.back_project(depth, (depth > 0) & ~_first_mask(folder))
    normal = wall_normal(background[:: max(1, len(background) // 5000)])
    if normal is None or abs(normal[2]) > 0.5:
        return camera
    lean = np.arcsin(normal[2])
    axis = np.array([normal[1], -normal[0], 0.0]) / np.hypot(normal[0], normal[1])
    pose = camera.world_from_camera.copy()
    pose[:3, :3] = cv2.Rodrigues(-lean * axis)[0] @ pose[:3, :3]
    return replace(camera, world_from_camera=pose)


def wall_normal(points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, " 3"] | None:
    """Return the normal of the plane with most points; None if it has less than a third."""
    rng = np.random.default_rng(0)
    best = np.zeros(len(points), dtype=bool)
    for _ in range(200):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        near = np.abs((points - a) @ normal) < WALL_M * length
        if length > 0 and near.sum() > best.sum():
            best = near
    if best.sum() < len(points) / 3:
        return None
    on_wall = points[best] - points[best].mean(axis=0)
    return np.linalg.svd(on_wall, full_matrices=False)[2][2]


def _to_world(camera: Camera, vectors: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    # The camera stands at the world's origin, so points turn as vectors do.
    return np.asarray(vectors, dtype=np.float64) @ camera.world_from_camera[:3, :3].T


def _masks(folder: Path, camera: Camera) -> tuple[Bool[np.ndarray, "height width"], ...]:
    # The set has no mask of the second frame: the shirt's colors are learned in the first.
    first, second = frame_numbers(folder)
    mask = _first_mask(folder)
    picture = read_picture(folder / f"color_{first:03d}.png")
    segmenter = ColorSegmenter(learned_set(picture, mask, ~mask))
    later = segmenter(
        read_picture(folder / f"color_{second:03d}.png"), _depth(folder, second), camera, None
    )
    return mask, main_components(later)


def _first_mask(folder: Path) -> Bool[np.ndarray, "height width"]:
    file = folder / f"mask_{frame_numbers(folder)[0]:03d}.png"
    return read_picture(file)[:, :, 0] > 127


def _depth(folder: Path, number: int) -> Float[np.ndarray, "height width"]:
    file = folder / f"depth_{number:03d}.png"
    units: UInt8[np.ndarray, "height width"] | None = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if units is None:
        raise InvalidRecordingError(f"{file}: not a readable picture")
    return units.astype(np.float32) * np.float32(1e-3)


def _grid_faces(index: Int[np.ndarray, "rows columns"]) -> Int[np.ndarray, "faces 3"]:
    # Two triangles per cell along alternating diagonals, where all their corners are measured.
    a, b, c, d = (
        index[rows, columns]
        for rows in (slice(None, -1), slice(1, None))
        for columns in (slice(None, -1), slice(1, None))
    )
    odd = (np.indices(a.shape).sum(axis=0) % 2 == 1)[..., None]
    first = np.where(odd, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(odd, np.stack([b, d, c], -1), np.stack([a, d, c], -1))
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    return faces[(faces >= 0).all(axis=1)].astype(np.int32)


def _largest_piece(
    points: Float[np.ndarray, "points 3"], faces: Int[np.ndarray, "faces 3"]
) -> ClothMesh:
    sides = faces[:, [[0, 1], [1, 2]]].reshape(-1, 2)
    links = coo_array((np.ones(len(sides), bool), sides.T), shape=(len(points), len(points)))
    _, label = connected_components(links, directed=False)
    faces = faces[label[faces[:, 0]] == np.bincount(label[faces[:, 0]]).argmax()]
    used, renumbered = np.unique(faces, return_inverse=True)
    return ClothMesh(points[used], renumbered.reshape(-1, 3).astype(np.int32))


def _held(mesh: ClothMesh, tip: Float[np.ndarray, " 3"]) -> Int[np.ndarray, " held"]:
    # A fist holds a patch, at least the nearest vertex.
    distance = np.linalg.norm(mesh.vertices - tip, axis=1)
    return np.flatnonzero(distance <= max(GRIP_RADIUS_M, distance.min())).astype(np.int32)
