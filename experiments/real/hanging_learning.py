"""hanging-cloth-rgbd for Table 2: a third of its frames is for testing, the others for training.

The camera is level, but the network expects a view from above. So the world is rotated until the
camera looks straight down and the hanging cloth lies. There is no table, and there are true depth
pictures.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from shared.bench_measures import Row

from clothtrack.evaluation.metrics import chamfer_surface
from clothtrack.evaluation.truth import material_map, material_points
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings, edge_strain
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.pseudo_labels import (
    LabeledRecording,
    cloth_picture,
    projected_faces,
)
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from real import hanging_cloth
from real.learned_cloth import KIND, Ask, corners
from real.upright import WORLD_FROM_CAMERA, upright

SPLITS = {
    "late": ((range(10), range(10, 20), range(20, 30)), range(35, 50)),
    "middle": ((range(6), range(6, 12), range(37, 50)), range(17, 32)),
    "early": ((range(20, 30), range(30, 40), range(40, 50)), range(15)),
}
"""Frames that are learned from, and those that are judged, by what is judged. A third of the
learned ones selects the weights. Five lie between: neighbors are alike."""

CUT_M = 0.02
NOISE_M = 0.0015
LOOKING_DOWN: Float[np.ndarray, "4 4"] = np.diag([1.0, -1.0, -1.0, 1.0])
"""Pose of the camera in the world that the network is shown."""

TURNS = np.array([[[a, 0], [0, b]] for a in (1, -1) for b in (1, -1)])
SQUARE = np.concatenate([TURNS, TURNS[:, ::-1]])
"""The eight ways to name a square without marks."""


@dataclass(frozen=True)
class HangingFrames:
    """Some frames of the hanging cloth."""

    name: str
    source: Path
    folder: Path
    frames: range

    @cached_property
    def recording(self) -> Recording:
        """The recording."""
        return read_recording(self.folder)

    @cached_property
    def size_m(self) -> tuple[float, float]:
        """Width and length of the flat cloth [m]."""
        flat = np.asarray(hanging_cloth.template(self.source).canonical)
        width, length = np.ptp(flat[:, :2], axis=0).tolist()
        return width, length

    def picture(self, frame: int) -> DepthInput:
        """Return what the network is shown: the depth picture, of a camera that looks down."""
        depth, mask, camera = self._seen(frame)
        return DepthInput(depth, mask, camera, None, KIND, self.size_m)

    def labeled(self, tracked: TrackedTrajectory) -> LabeledRecording:
        """Return every frame, labeled by the tracker."""
        pictures = [
            self._labeled_picture(self._seen(frame), tracked, frame) for frame in self.frames
        ]
        return self._of(self.name, tracked.mesh, list(self.frames), pictures)

    def simulated(self, simulated: TrackedTrajectory) -> LabeledRecording:
        """Return the same frames of a simulated cloth, with noise; it has no holes."""
        rng = np.random.default_rng([*self.name.encode()])
        pictures = []
        for frame in self.frames:
            _, _, camera = self._seen(frame)
            drawn = Rasterizer(simulated.mesh.faces, camera).render(_shown(simulated, frame))
            measured = drawn.depth + rng.normal(0.0, NOISE_M, drawn.depth.shape)
            depth = np.where(np.isfinite(measured), measured, 0.0).astype(np.float32)
            seen = depth, depth > 0, camera
            pictures.append(self._labeled_picture(seen, simulated, frame))
        return self._of(f"simulated_{self.name}", simulated.mesh, list(self.frames), pictures)

    def tracked_mesh(self, tracked: TrackedTrajectory) -> Ask:
        """Return the tracker's mesh by frame, in the world that the network is shown."""
        return lambda frame: (tracked.mesh.with_vertices(_shown(tracked, frame)), tracked.mesh)

    def judged(
        self, frame: int, mesh: ClothMesh, rest: ClothMesh, tracked: TrackedTrajectory
    ) -> Row:
        """Return the measures of a frame's mesh, including both held corners and the print."""
        label = tracked.mesh.with_vertices(_shown(tracked, frame))
        material = self._named(mesh, label)
        positions = mesh.vertices.astype(np.float64)
        score = hanging_cloth.score(
            _upright(positions)[None], mesh.faces, self.source, material=material,
            frames=np.array([frame]),
        )  # fmt: skip
        (print_of,) = score.drift.values()
        grips = [path.positions[frame] for path in self.recording.picker_paths.values()]
        apart = np.linalg.norm(
            _upright(corners(mesh))[:, None] - np.array(grips)[None], axis=2
        ).min(axis=0)
        return {
            "chamfer_pc_m2": float(score.chamfer_surface_m2[0]),
            "chamfer_mesh_m2": chamfer_surface(
                (positions, mesh.faces), (label.vertices.astype(np.float64), label.faces)
            ),
            "corner_mm": 1e3 * float(apart.mean()),
            "edge_strain": edge_strain(rest, positions),
            "crossings_per_1000_edges": 1e3 * crossings(positions, mesh.faces) / len(mesh.edges),
            "print_matched": print_of.matched,
            "print_slide_mm": print_of.mean_slide_mm,
        }

    def _seen(
        self, frame: int
    ) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"], Camera]:
        depth, mask, camera = cloth_picture(self.recording, self.recording.frames[frame])
        return depth, mask, replace(camera, world_from_camera=LOOKING_DOWN)

    def _labeled_picture(
        self, seen: tuple, tracked: TrackedTrajectory, frame: int
    ) -> LabeledPicture:
        depth, mask, camera = seen
        positions = _shown(tracked, frame)
        faces = projected_faces(depth, mask, camera, positions, tracked.mesh.faces, cut_m=CUT_M)
        return LabeledPicture(depth, mask, camera, faces, positions)

    def _of(
        self, name: str, mesh: ClothMesh, frames: list[int], pictures: list[LabeledPicture]
    ) -> LabeledRecording:
        # The first mesh tells where the table is; this cloth has none, and hangs over its lowest.
        low = min((float(one.positions[:, 2].min()) for one in pictures), default=0.0)
        flat = np.asarray(mesh.canonical, np.float64) + (0.0, 0.0, low)
        return LabeledRecording(
            name, KIND, mesh.with_vertices(flat), tuple(frames), tuple(pictures)
        )

    def _named(self, mesh: ClothMesh, label: ClothMesh) -> Float[np.ndarray, "vertices 2"]:
        """Return flat coordinates of the vertices under the best of the square's eight symmetries.

        The network is not given which corner of a square is which.
        """
        given = hanging_cloth.template(self.source)
        middle = 0.5 * (given.canonical.min(axis=0) + given.canonical.max(axis=0))
        flat = np.asarray(mesh.canonical, np.float64)
        flat = (flat - 0.5 * (flat.min(axis=0) + flat.max(axis=0)))[:, :2]
        namings = [flat @ turn.T + middle[:2] for turn in SQUARE]
        known = np.asarray(label.canonical, np.float64)
        apart = []
        for naming in namings:
            places = np.concatenate([naming, np.zeros((len(naming), 1))], axis=1)
            where = material_map(known, label.faces, places)
            true = material_points(label.vertices.astype(np.float64), label.faces, where)
            apart.append(float(np.linalg.norm(true - mesh.vertices, axis=1).mean()))
        return namings[int(np.argmin(apart))]


def hanging_frames(data: Path, output: Path) -> dict[str, dict[str, list[HangingFrames]]]:
    """Return the set in a folder, split into "train" and the judged parts of `SPLITS`.

    It is empty without the set.
    """
    source = data / hanging_cloth.NAME
    if not source.is_dir():
        return {}
    folder = output / hanging_cloth.NAME
    if not folder.exists():
        hanging_cloth.convert(source, folder)

    def some(frames: range) -> HangingFrames:
        name = f"hanging_{frames.start}_{frames.stop}"
        return HangingFrames(name, source, folder, frames)

    return {
        split: {"train": [some(each) for each in learned], split: [some(judged)]}
        for split, (learned, judged) in SPLITS.items()
    }


def _shown(tracked: TrackedTrajectory, frame: int) -> Float[np.ndarray, "vertices 3"]:
    """Return tracked vertices in the world that the network is shown [m]."""
    in_camera = np.asarray(tracked.positions[frame], np.float64) @ WORLD_FROM_CAMERA[:3, :3]
    return in_camera @ LOOKING_DOWN[:3, :3].T


def _upright(points: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    """Return points of the world that the network is shown, in the recording's [m]."""
    return upright(points @ LOOKING_DOWN[:3, :3])
