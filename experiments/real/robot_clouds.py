"""robot-lift-fold-clouds: napkins lifted or folded by a robot, as clouds of two cameras.

The source removed all points below a height and near the tool, so missing points there carry no
information. The path is the commanded one; where the tool really held the cloth is not known.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidRecordingError
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.chamfer import one_way
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import edge_strain
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.recording import ClothDescription, ObservedRegion, PickerPath, Table
from clothtrack.recordings.store import RecordingWriter

NAME = "robot-lift-fold-clouds"
PICKER = "gripper"
CELLS = 32
RESTING_HEIGHT_M = 0.0015
FIRST_SCORED_FRAME = 6
BAND_M = 0.012
TOOL_CLEARANCE_M = 0.045
GRASP_UNCERTAINTY_M = 0.02
VISIBILITY_TOLERANCE_M = 0.004
LINK_M = 0.012
LEAST_CLUSTER = 0.04


@dataclass(frozen=True, eq=False)
class RobotSequence:
    """One lift or fold, as stored.

    Attributes:
        task: "lift" or "fold": which start square it has.
        clouds: measured points per frame, robot frame [m].
        gripper: commanded tool position per frame [m].
        time_s: nominal times [s].
        lowest_z_m: height under which the source removed points [m].
        square: corners of the flat start square [m], in order around it.
        picked: the corner that the robot takes [m].
        table_height_m: height of the table [m].
    """

    name: str
    task: str
    clouds: tuple[Float[np.ndarray, "points 3"], ...]
    gripper: Float[np.ndarray, "frames 3"]
    time_s: Float[np.ndarray, " frames"]
    lowest_z_m: float
    cameras: tuple[Camera, ...]
    square: Float[np.ndarray, "4 3"]
    picked: Float[np.ndarray, " 3"]
    table_height_m: float


@dataclass(frozen=True, eq=False)
class RobotCloudScore:
    """How well tracked positions fit one sequence, for each scored frame.

    Attributes:
        chamfer_pc_m2: counted visible vertices against counted points [m^2].
        cloud_to_mesh_m2: its half from points to vertices [m^2].
        band_as_target_m2: the same Chamfer distance where what lies in the band is not judged but
            may be met [m^2]. Dropping it outright charges a vertex a millimeter above the band,
            whose point lies a millimeter inside it, the way to the next counted point: 10 cm.
        edge_strain: mean absolute relative change of edge length.
    """

    frames: Int[np.ndarray, " frames"]
    chamfer_pc_m2: Float[np.ndarray, " frames"]
    cloud_to_mesh_m2: Float[np.ndarray, " frames"]
    band_as_target_m2: Float[np.ndarray, " frames"]
    edge_strain: Float[np.ndarray, " frames"]

    def summary(self) -> dict[str, float]:
        """Return the figures that the set's targets name."""
        return {
            "chamfer_pc_m2": float(np.nanmean(self.chamfer_pc_m2)),
            "median_m2": float(np.nanmedian(self.chamfer_pc_m2)),
            "worst_frame_m2": float(np.nanmax(self.chamfer_pc_m2)),
            "cloud_to_mesh_m2": float(np.nanmean(self.cloud_to_mesh_m2)),
            "band_as_target_m2": float(np.nanmean(self.band_as_target_m2)),
            "band_as_target_worst_m2": float(np.nanmax(self.band_as_target_m2)),
            "edge_strain": float(self.edge_strain.mean()),
        }


def sequences(folder: Path) -> list[Path]:
    """Return the stored sequences of the set, folds first, in order of name."""
    return sorted((folder / "sequences").glob("*.npz"))


def load(file: Path) -> RobotSequence:
    """Read one stored sequence with what `meta.json` beside its folder says about it."""
    meta = json.loads((file.parents[1] / "meta.json").read_text())
    facts = next((s for s in meta["sequences"] if s["name"] == file.stem), {})
    task = facts.get("task", file.stem.split("_")[0])
    if task not in meta["initial_cloth"]:
        raise InvalidRecordingError(
            f"{file}: task {task!r} has no start square in meta.json; known are "
            f"{', '.join(meta['initial_cloth'])}"
        )
    with np.load(file) as stored:
        points = stored["points_tenth_mm"].astype(np.float64) * 1e-4
        offsets, gripper, time_s = stored["offsets"], stored["gripper_m"], stored["time_s"]
    start = meta["initial_cloth"][task]
    lowest_z_m = float(facts.get("lowest_z_m", points[:, 2].min()))
    # The square's height is where the source's authors put it in their simulation. Cloth was
    # measured below it in the lifts, and cloth is never inside a table: the square goes down with
    # the table, as far as the measured points demand.
    sunk = max(0.0, float(start["table_height_m"]) - lowest_z_m)
    return RobotSequence(
        name=file.stem,
        task=task,
        clouds=tuple(points[a:b] for a, b in pairwise(offsets)),
        gripper=gripper.astype(np.float64),
        time_s=time_s.astype(np.float64),
        lowest_z_m=lowest_z_m,
        cameras=tuple(_camera(name, values) for name, values in meta["cameras"].items()),
        square=np.array(start["corners_m"], dtype=np.float64) - (0.0, 0.0, sunk),
        picked=np.array(start["picked_corner_m"], dtype=np.float64) - (0.0, 0.0, sunk),
        table_height_m=float(start["table_height_m"]) - sunk,
    )


def start_mesh(sequence: RobotSequence) -> ClothMesh:
    """Return the start square as a grid of 33 x 33 vertices, resting on the table [m]."""
    side = float(np.linalg.norm(sequence.square[1] - sequence.square[0]))
    flat = towel(width_m=side, length_m=side, spacing_m=side / CELLS)
    u, v = (flat.canonical[:, :2] / side + 0.5).T
    shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v], axis=1)
    return flat.with_vertices(shares @ sequence.square + (0.0, 0.0, RESTING_HEIGHT_M))


def convert(file: Path, output: Path, *, frames: int | None = None) -> Path:
    """Write one sequence as a recording that has only clouds, and return its folder."""
    sequence = load(file)
    mesh = start_mesh(sequence)
    held = int(np.linalg.norm(mesh.vertices - sequence.picked, axis=1).argmin())
    count = len(sequence.clouds[:frames])
    with RecordingWriter(
        output,
        cameras=sequence.cameras,
        depth_units_m={camera.name: 0.001 for camera in sequence.cameras},
        table=Table(np.array([0.0, 0.0, sequence.table_height_m]), np.array([0.0, 0.0, 1.0])),
        cloth=ClothDescription(
            kind="towel",
            template=mesh,
            held_vertices={PICKER: np.array([held], dtype=np.int32)},
            grasp_uncertainty_m=GRASP_UNCERTAINTY_M,
        ),
        observed=ObservedRegion(sequence.lowest_z_m, TOOL_CLEARANCE_M),
        provenance={"source": NAME, "sequence": sequence.name, "picker_path": "commanded"},
    ) as writer:
        for cloud, time_s in zip(sequence.clouds[:count], sequence.time_s[:count], strict=True):
            writer.add_frame(float(time_s), color=None, depth=None, mask=None, cloud=cloud)
        closed = np.ones(count, dtype=bool)
        path = PickerPath(sequence.time_s[:count], sequence.gripper[:count], closed)
        writer.set_picker_path(PICKER, path)
        writer.add_action(0, count - 1, (PICKER,))
    return output


def without_strays(cloud: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "kept 3"]:
    """Return the cloud without clusters (linked within 12 mm) that hold under 4 % of its points."""
    if len(cloud) == 0:
        return cloud
    pairs = cKDTree(cloud).query_pairs(LINK_M, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(cloud), len(cloud)))
    _, label = connected_components(links, directed=False)
    return cloud[np.bincount(label)[label] >= LEAST_CLUSTER * len(cloud)]


def score(
    positions: Float[np.ndarray, "frames vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    file: Path,
    *,
    rest: ClothMesh | None = None,
    frames: Sequence[int] | None = None,
    first: int = FIRST_SCORED_FRAME,
) -> RobotCloudScore:
    """Score positions of the cloth (before the final alignment) against one sequence.

    Args:
        positions: vertices in the robot's frame [m], one row per frame.
    """
    sequence = load(file)
    rest = start_mesh(sequence) if rest is None else rest
    visible = VisibilityCheck(faces, sequence.cameras, tolerance_m=VISIBILITY_TOLERANCE_M)
    numbers = range(len(positions)) if frames is None else frames
    rows = [(frame, p) for frame, p in zip(numbers, positions, strict=True) if frame >= first]
    halves = np.array([_halves(sequence, frame, p, visible(p)) for frame, p in rows])
    return RobotCloudScore(
        frames=np.array([frame for frame, _ in rows]),
        chamfer_pc_m2=halves[:, :2].sum(axis=1),
        cloud_to_mesh_m2=halves[:, 0],
        band_as_target_m2=halves[:, 2],
        edge_strain=np.array([edge_strain(rest, p) for _, p in rows]),
    )


def _halves(
    sequence: RobotSequence,
    frame: int,
    vertices: Float[np.ndarray, "vertices 3"],
    visible: Bool[np.ndarray, " vertices"],
) -> tuple[float, float, float]:
    # Points to vertices and vertices to points [m^2], each over what counts; and their sum when
    # the band may be met.
    counts_above = sequence.lowest_z_m + BAND_M
    measured = without_strays(sequence.clouds[frame])
    cloud = measured[measured[:, 2] >= counts_above]
    if len(cloud) == 0:
        return np.nan, np.nan, np.nan
    counted = visible & (vertices[:, 2] >= counts_above)
    # A mesh that left all that counts is as far from the points as its visible part is.
    targets = next(v for v in (vertices[counted], vertices[visible], vertices) if len(v))
    judged = counted & (
        np.linalg.norm(vertices - sequence.gripper[frame], axis=1) > TOOL_CLEARANCE_M
    )
    backward = one_way(vertices[judged], cloud) if judged.any() else 0.0
    met = one_way(cloud, vertices[visible]) if visible.any() else np.nan
    met += one_way(vertices[judged], measured) if judged.any() else 0.0
    return one_way(cloud, targets), backward, met


def _camera(name: str, values: dict) -> Camera:
    pose = np.eye(4)
    pose[:3] = values["camera_to_robot_3x4"]
    pinhole = {key: values[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    return Camera(name, **pinhole, world_from_camera=pose)
