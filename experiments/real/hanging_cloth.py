"""hanging-cloth-rgbd: a real printed cloth held by two corners, seen by one RGB-D camera.

The tracker gets color, depth, the mask, the template and the two held corners. The measured
points are read by the scorer only. The set states no frame rate (1/30 s is assumed) and has no
pick-and-place: the action is to hold still.
"""

import csv
from dataclasses import dataclass
from itertools import pairwise
from math import isqrt
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.chamfer import sample_surface, two_way
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import edge_strain
from clothtrack.recordings.recording import ClothDescription, PickerPath
from clothtrack.recordings.store import RecordingWriter
from real.pattern import PatternConfig, PatternDrift, Unwrapper, pattern_drift
from real.upright import level_camera, upright

NAME = "hanging-cloth-rgbd"
FRAME_TIME_S = 1.0 / 30.0
SURFACE_SAMPLES = 40_000
CAMERA = "camera"


@dataclass(frozen=True, eq=False)
class HangingClothScore:
    """How well tracked positions fit the set, frame by frame.

    Attributes:
        chamfer_surface_m2: surface samples against measured points, per frame [m^2].
        edge_strain: mean absolute relative change of edge length, per frame.
        drift: pattern drift at a fifth, two fifths, ... of the recording and at its last frame.
    """

    chamfer_surface_m2: Float[np.ndarray, " frames"]
    edge_strain: Float[np.ndarray, " frames"]
    drift: dict[int, PatternDrift]

    @property
    def worst_drift_mm(self) -> float | None:
        """Worst mean slide of the judged frames [mm]; None when the print is lost in one."""
        slides = [drift.mean_slide_mm for drift in self.drift.values()]
        return None if None in slides else max(slides)

    def summary(self) -> dict[str, object]:
        """Return the figures that the set's targets name."""
        return {
            "chamfer_surface_m2": float(self.chamfer_surface_m2.mean()),
            "worst_frame_m2": float(self.chamfer_surface_m2.max()),
            "edge_strain": float(self.edge_strain.mean()),
            "pattern_drift_mm": self.worst_drift_mm,
            "pattern_matched": self.drift[max(self.drift)].matched,
            "pattern_drift_by_frame_mm": {
                str(frame): drift.mean_slide_mm for frame, drift in self.drift.items()
            },
            "pattern_matched_by_frame": {
                str(frame): drift.matched for frame, drift in self.drift.items()
            },
        }


def frame_count(folder: Path) -> int:
    """Return the number of frames of the set."""
    return len(_pictures(folder, "color"))


def template(folder: Path) -> ClothMesh:
    """Return the given first-frame cloth in the world; quads are cut along alternating diagonals.

    Its canonical coordinates are its flat ones [m], (x, y, 0).
    """
    files = sorted(folder.glob("template*.obj"))
    if not files:
        raise InvalidRecordingError(f"{folder}: no template*.obj; the set needs its first mesh")
    rows = [line.split() for line in files[0].read_text().splitlines()]
    vertices = np.array([row[1:4] for row in rows if row[:1] == ["v"]], dtype=np.float64)
    quads = [[int(c.split("/")[0]) - 1 for c in row[1:]] for row in rows if row[:1] == ["f"]]
    side = isqrt(len(vertices))
    if side * side != len(vertices) or {len(quad) for quad in quads} != {4}:
        raise InvalidRecordingError(
            f"{files[0]}: {len(vertices)} vertices and faces of "
            f"{sorted({len(quad) for quad in quads})} corners; expected a square grid of quads"
        )
    faces = []
    for quad in quads:
        # Which corner comes first differs from quad to quad: start at the lowest vertex.
        a, b, c, d = np.roll(quad, -int(np.argmin(quad))).tolist()
        odd = sum(divmod(a, side)) % 2
        faces += [(a, b, c), (a, c, d)] if odd else [(a, b, d), (b, c, d)]
    grid = upright(vertices).reshape(side, side, 3)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).mean() for axis in (0, 1)]
    flat = np.stack(np.meshgrid(*(np.arange(side) * step for step in steps), indexing="ij"), -1)
    canonical = np.concatenate([flat.reshape(-1, 2), np.zeros((len(vertices), 1))], axis=1)
    return ClothMesh(grid.reshape(-1, 3), np.array(faces, dtype=np.int32), canonical)


def measured_points(folder: Path) -> list[Float[np.ndarray, "points 3"]]:
    """Return the measured cloth of every frame, in the world [m]; for scoring only."""
    with np.load(folder / "points.npz") as stored:
        points, offsets = upright(stored["points_mm"] * 1e-3), stored["offsets"]
    return [points[a:b] for a, b in pairwise(offsets)]


def convert(folder: Path, output: Path, *, frames: int | None = None) -> Path:
    """Write the set as a recording and return its folder."""
    camera = level_camera(folder / "intrinsics.json", CAMERA)
    mesh = template(folder)
    grips, held = _grips(folder / "actions.csv")
    color = _pictures(folder, "color")[:frames]
    times = np.arange(len(color)) * FRAME_TIME_S
    cloth = ClothDescription(kind="towel", template=mesh, held_vertices=held)
    with RecordingWriter(
        output,
        cameras=(camera,),
        depth_units_m={CAMERA: 0.001},
        table=None,
        cloth=cloth,
        provenance={"source": NAME, "frame_time": "1/30 s, assumed"},
    ) as writer:
        for picture, time_s in zip(color, times, strict=True):
            depth = cv2.imread(str(folder / "depth" / picture.name), cv2.IMREAD_UNCHANGED)
            mask = cv2.imread(str(folder / "mask" / picture.name), cv2.IMREAD_GRAYSCALE)
            writer.add_frame(
                float(time_s),
                color={CAMERA: read_picture(picture)},
                depth={CAMERA: depth.astype(np.float32) * 1e-3},
                mask={CAMERA: mask > 127},
            )
        for name, path in grips.items():
            writer.set_picker_path(
                name, PickerPath(times, path[: len(times)], np.ones(len(times), dtype=bool))
            )
        writer.add_action(0, len(times) - 1, tuple(grips))
    return output


def score(
    positions: Float[np.ndarray, "frames vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    folder: Path,
    *,
    material: Float[np.ndarray, "vertices 2"] | None = None,
    frames: Int[np.ndarray, " frames"] | None = None,
    config: PatternConfig | None = None,
) -> HangingClothScore:
    """Score positions of the cloth (before the final alignment) against the set.

    Args:
        positions: vertices in the world [m], one row per frame.
        material: flat coordinates of the vertices [m]; None when they are the template's.
    """
    points, given = measured_points(folder), template(folder)
    frames = np.arange(len(positions)) if frames is None else frames
    if material is None:
        material, rest = given.canonical[:, :2], ClothMesh(given.vertices, faces)
    else:
        rest = ClothMesh(np.concatenate([material, np.zeros((len(material), 1))], 1), faces)
    chamfer = np.array(
        [
            two_way(sample_surface(p, faces, SURFACE_SAMPLES, seed=0), points[f])
            for p, f in zip(positions, frames, strict=True)
        ]
    )
    strain = np.array([edge_strain(rest, p) for p in positions])
    return HangingClothScore(chamfer, strain, _drift(positions, frames, folder, material, config))


def _drift(
    positions: Float[np.ndarray, "frames vertices 3"],
    frames: Int[np.ndarray, " frames"],
    folder: Path,
    material: Float[np.ndarray, "vertices 2"],
    config: PatternConfig | None,
) -> dict[int, PatternDrift]:
    # The reference print comes from the given template, so that a slide inside the first tracked
    # frame counts too.
    pictures, given = _pictures(folder, "color"), template(folder)
    camera = level_camera(folder / "intrinsics.json", CAMERA)
    first = Unwrapper(given.canonical[:, :2], config)(
        read_picture(pictures[0]), given.vertices, camera
    )
    unwrap = Unwrapper(material, config)
    drift = {}
    for row in judged_rows(len(positions)):
        picture = read_picture(pictures[frames[row]])
        later = unwrap(picture, positions[row], camera)
        drift[int(frames[row])] = pattern_drift(first, later, config)
    return drift


def judged_rows(count: int) -> list[int]:
    """Return rows at each fifth of the recording and its last (10, 20, 30, 40, 49 of 50)."""
    return sorted({min(round(part * count / 5), count - 1) for part in range(1, 6)})


def read_picture(file: Path) -> np.ndarray:
    """Return a color picture (height, width, RGB)."""
    picture = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if picture is None:
        raise InvalidRecordingError(f"{file}: not a readable picture")
    return np.ascontiguousarray(picture[:, :, ::-1])


def _pictures(folder: Path, kind: str) -> list[Path]:
    files = sorted((folder / kind).glob("*.png"))
    if not files:
        raise InvalidRecordingError(f"{folder / kind}: no pictures")
    return files


def _grips(
    file: Path,
) -> tuple[dict[str, Float[np.ndarray, "frames 3"]], dict[str, Int[np.ndarray, " held"]]]:
    # Path of each grip in the world [m], and the template vertex that it holds.
    paths: dict[str, list[list[float]]] = {}
    held = {}
    with file.open(newline="") as lines:
        for row in csv.DictReader(lines):
            name = f"grip{row['grip']}"
            paths.setdefault(name, []).append([float(row[axis]) for axis in "xyz"])
            held[name] = np.array([int(row["vertex"])], dtype=np.int32)
    return {name: upright(np.array(path)) for name, path in paths.items()}, held
