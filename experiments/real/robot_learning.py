"""robot-lift-fold-clouds for the paper's Table 2: labels, splits and scores.

A network is given the merged cloud as seen by a camera straight above, and the napkin's side. It is
never given the position of the gripper, which holds a corner.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from shared.bench_measures import Row

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.metrics import chamfer_surface
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.cloud_picture import LEAST_POINTS, cloud_picture
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.pseudo_labels import (
    LabeledRecording,
    PseudoLabel,
    label_recording,
    projected_faces,
)
from clothtrack.reconstruction.depth_input import DepthInput, from_cloud
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from real import robot_clouds
from real.learned_cloth import KIND, Ask, corners
from real.robot_clouds import TOOL_CLEARANCE_M, RobotSequence

FRAMES = range(6, 25)
"""Before them the clouds hold few points, some of them stray."""

TO_CHOOSE = ("lift_tan2", "fold_tan")
"""Another day, another fold: never learned from."""

CUT_M = 0.02
NOISE_M = 0.0015
"""Of a simulated point along each axis [m]."""

UNDER_M = 0.015
"""A point so far [m] under what the picture shows is what the side camera saw alone."""

LEAST_UNDER = 20


@dataclass(frozen=True)
class Napkin:
    """One sequence: what was measured, and the recording that was made of it."""

    file: Path
    folder: Path

    @property
    def name(self) -> str:
        """Name of the sequence."""
        return self.file.stem

    @cached_property
    def sequence(self) -> RobotSequence:
        """The stored sequence."""
        return robot_clouds.load(self.file)

    @cached_property
    def recording(self) -> Recording:
        """The recording."""
        return read_recording(self.folder)

    @cached_property
    def flat(self) -> ClothMesh:
        """The start square; its edges are the rest lengths [m]."""
        return robot_clouds.start_mesh(self.sequence)

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and length of the napkin [m]."""
        side_m = float(np.linalg.norm(self.sequence.square[1] - self.sequence.square[0]))
        return side_m, side_m

    @property
    def frames(self) -> list[int]:
        """The frames that are learned from, or judged."""
        return [frame for frame in FRAMES if frame < len(self.sequence.clouds)]

    def picture(self, frame: int) -> DepthInput:
        """Return the network's input."""
        return from_cloud(
            self._points(frame),
            self.recording.table,
            kind=KIND,
            size_m=self.size_m,
        )

    def labeled(self, tracked: TrackedTrajectory) -> LabeledRecording:
        """Return every judged frame, labeled by the tracker."""
        positions = np.asarray(tracked.positions, np.float64)
        labels = [PseudoLabel(frame, positions[frame]) for frame in self.frames]
        return label_recording(
            self.recording, tracked.mesh, labels, kind=KIND, cut_m=CUT_M,
            provenance={"sequence": self.name},
        )  # fmt: skip

    def simulated(self, simulated: TrackedTrajectory) -> LabeledRecording:
        """Return the same lift of a simulated napkin, recorded and cut like the real one.

        Both cameras see it. Points below the cut or near the tool are removed, as many points stay
        as were measured, and each has noise. Its label is exact.
        """
        rng = np.random.default_rng([*self.name.encode()])
        positions, faces = np.asarray(simulated.positions, np.float64), simulated.mesh.faces
        pictures, frames = [], []
        for frame in self.frames:
            points = _filmed(self.sequence, frame, positions[frame], faces, rng)
            if len(points) < LEAST_POINTS:
                continue
            depth, mask, camera = cloud_picture(points)
            shown = projected_faces(depth, mask, camera, positions[frame], faces, cut_m=CUT_M)
            pictures.append(LabeledPicture(depth, mask, camera, shown, positions[frame]))
            frames.append(frame)
        return LabeledRecording(
            f"simulated_{self.name}", KIND, simulated.mesh, tuple(frames), tuple(pictures),
            {"sequence": self.name, "simulated": True},
        )  # fmt: skip

    def tracked_mesh(self, tracked: TrackedTrajectory) -> Ask:
        """Return the tracker's mesh by frame."""
        return lambda frame: (_mesh_at(tracked, frame), tracked.mesh)

    def judged(
        self, frame: int, mesh: ClothMesh, rest: ClothMesh, tracked: TrackedTrajectory
    ) -> Row:
        """Return the measures of one mesh of one frame; the gripper's corner among them."""
        positions, label = mesh.vertices.astype(np.float64), _mesh_at(tracked, frame)
        cloud = robot_clouds.score(
            positions[None], mesh.faces, self.file, rest=rest, frames=[frame]
        )
        under = self.under(frame)
        aside = distance_to_mesh(under, positions, mesh.faces).mean() if len(under) else np.nan
        gripper_m = np.linalg.norm(corners(mesh) - self.sequence.gripper[frame], axis=1)
        return {
            "chamfer_pc_m2": float(cloud.chamfer_pc_m2[0]),
            "band_as_target_m2": float(cloud.band_as_target_m2[0]),
            "chamfer_mesh_m2": chamfer_surface(
                (positions, mesh.faces), (label.vertices.astype(np.float64), label.faces)
            ),
            "corner_mm": 1e3 * float(gripper_m.min()),
            "edge_strain": float(cloud.edge_strain[0]),
            "crossings_per_1000_edges": 1e3 * crossings(positions, mesh.faces) / len(mesh.edges),
            "second_camera_mm": 1e3 * float(aside) if len(under) >= LEAST_UNDER else None,
        }

    def under(self, frame: int) -> Float[np.ndarray, "points 3"]:
        """Return points [m] that the picture does not show: the second camera's alone."""
        points = self._points(frame)
        depth, _, camera = cloud_picture(points)
        pixels, far = camera.project(points)
        columns, rows = np.rint(pixels).astype(int).T
        shown = depth[rows, columns]
        return points[(shown > 0) & (far > shown + UNDER_M)]

    def _points(self, frame: int) -> Float[np.ndarray, "points 3"]:
        return observe(self.recording, self.recording.frames[frame], spacing_m=None).points


def _mesh_at(tracked: TrackedTrajectory, frame: int) -> ClothMesh:
    return tracked.mesh.with_vertices(np.asarray(tracked.positions[frame], np.float64))


def napkins(data: Path, output: Path) -> list[Napkin]:
    """Return the sequences of a folder, or of the set in it, as recordings below `output`."""
    inside = data / robot_clouds.NAME
    files = robot_clouds.sequences(inside if inside.is_dir() else data)
    if not files:
        raise InvalidConfigError(
            f"{data}: there are no sequences/*.npz, here or in {robot_clouds.NAME}; name the "
            "folder that holds the set"
        )
    found = []
    for file in files:
        folder = output / file.stem
        if not folder.exists():
            robot_clouds.convert(file, folder)
        found.append(Napkin(file, folder))
    return found


def refuse_shared(learned: Sequence[Napkin], judged: Sequence[Napkin]) -> None:
    """Refuse frames that are used for both training and testing, under any name."""
    known = {cloud: one for one in learned for cloud in _clouds(one)}
    for one in judged:
        shared = [known[cloud] for cloud in _clouds(one) if cloud in known]
        if shared:
            raise InvalidConfigError(
                f"{one.file} has {len(shared)} frames of {shared[0].file}, which is learned from; "
                "what is measured on must not be learned from: take it out of --test"
            )


def _clouds(napkin: Napkin) -> list[bytes]:
    clouds = (np.ascontiguousarray(cloud, np.float64) for cloud in napkin.sequence.clouds)
    return [hashlib.sha256(cloud.tobytes()).digest() for cloud in clouds if len(cloud)]


def _filmed(
    sequence: RobotSequence,
    frame: int,
    positions: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "points 3"]:
    clouds = []
    for camera in sequence.cameras:
        depth = Rasterizer(faces, camera).render(positions).depth
        clouds.append(camera.back_project(depth, np.isfinite(depth) & (depth > 0)))
    cloud = np.concatenate(clouds)
    apart = np.linalg.norm(cloud - sequence.gripper[frame], axis=1)
    cloud = cloud[(cloud[:, 2] >= sequence.lowest_z_m) & (apart > TOOL_CLEARANCE_M)]
    kept = rng.permutation(len(cloud))[: len(sequence.clouds[frame])]
    return cloud[kept] + rng.normal(0.0, NOISE_M, (len(kept), 3))
