"""Pseudo-labels: tracking results of a recording as training examples (Sec. III-C).

Tracked vertices keep the canonical coordinates of the first mesh. Each measured pixel is projected
to the part of the tracked mesh that the camera sees, and has no label if the mesh is too far.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.errors import (
    InvalidMeshError,
    InvalidRecordingError,
    InvalidResultError,
)
from clothtrack.files.arrays import read_npz, write_npz
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import closest_on_mesh, interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.cloud_picture import cloud_picture
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.point_cloud import cloth_measured, observe
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import (
    Segmenter,
    cloth_found_by,
    default_segmenter,
    main_components,
)

FORMAT = "clothtrack-pseudo-labels"
FORMAT_VERSION = 1

FARTHEST_M = 100.0
"""Largest valid depth or coordinate in labels [m]; larger numbers are not in meters."""


@dataclass(frozen=True, eq=False)
class PseudoLabel:
    """One frame of a recording, labeled by the tracker.

    Attributes:
        frame: index of the frame in the recording.
        positions: tracked vertices in the world [m].
    """

    frame: int
    positions: Float[np.ndarray, "vertices 3"]


@dataclass(frozen=True, eq=False)
class LabeledRecording:
    """Labeled pictures of one recording, the unit that a split keeps together.

    Attributes:
        mesh: the first mesh, flat, with canonical coordinates [m].
        frames: indices of the frames in the recording.
        pictures: pictures of these frames, in the same order.
    """

    name: str
    kind: str
    mesh: ClothMesh
    frames: tuple[int, ...]
    pictures: tuple[LabeledPicture, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)


def label_recording(
    recording: Recording,
    mesh: ClothMesh,
    labels: Sequence[PseudoLabel],
    *,
    kind: str,
    cut_m: float = 0.02,
    segmenter: Segmenter | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> LabeledRecording:
    """Return pictures and projected labels of a tracked recording.

    Args:
        cut_m: pixels farther than this [m] from the tracked mesh have no label.
    """
    pictures = []
    for label in labels:
        if not 0 <= label.frame < len(recording.frames):
            raise InvalidResultError(
                f"a label belongs to frame {label.frame}, but {recording.folder} has "
                f"{len(recording.frames)} frames; give the recording that it was tracked from"
            )
        depth, mask, camera = cloth_picture(recording, recording.frames[label.frame], segmenter)
        positions = np.asarray(label.positions, np.float64)
        faces = projected_faces(depth, mask, camera, positions, mesh.faces, cut_m=cut_m)
        pictures.append(LabeledPicture(depth, mask, camera, faces, positions))
    frames = tuple(label.frame for label in labels)
    return LabeledRecording(
        recording.name, kind, mesh, frames, tuple(pictures), dict(provenance or {})
    )


def cloth_picture(
    recording: Recording, frame: Frame, segmenter: Segmenter | None = None
) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"], Camera]:
    """Return depth [m], cloth mask and camera of a frame, from its first camera with depth.

    A frame that has only a cloud is rendered from a camera straight above.
    """
    camera = next((one for one in recording.cameras if one.name in frame.depth), None)
    if camera is None and frame.cloud is not None:
        return cloud_picture(observe(recording, frame, spacing_m=None).points)
    if camera is None:
        raise InvalidRecordingError(
            f"{recording.folder}: frame {frame.index} has neither a depth picture nor a cloud; the "
            "network needs one"
        )
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    color = read_color(frame.color[camera.name]) if camera.name in frame.color else None
    find = segmenter or default_segmenter(recording, frame, camera)
    mask = cloth_found_by(find, recording, frame, camera, color=color, depth_m=depth)
    mask = main_components(mask)
    return depth, cloth_measured(depth, mask, camera), camera


def projected_faces(
    depth: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"],
    camera: Camera,
    positions: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    *,
    cut_m: float,
) -> Int[np.ndarray, "height width"]:
    """Return the face that each measured pixel of cloth shows; -1 if none is near.

    Only faces that the camera sees are candidates, because in a folded cloth the layer below is
    just as near.

    Args:
        depth: measured depth [m].
        positions: vertices in the world [m].
        cut_m: largest distance of pixel and face [m].
    """
    shown = np.full(depth.shape, -1, np.int32)
    drawn = Rasterizer(faces, camera).render(positions).faces
    seen = np.unique(drawn[drawn >= 0])
    points = camera.back_project(depth, mask)
    if len(seen) == 0 or len(points) == 0:
        return shown
    used, corners = np.unique(faces[seen], return_inverse=True)
    corners = corners.reshape(-1, 3)
    face, weights = closest_on_mesh(points, positions[used], corners)
    nearest = interpolate(weights, positions[used][corners[face]])
    near = np.linalg.norm(nearest - points, axis=1) <= cut_m
    shown[mask & (depth > 0)] = np.where(near, seen[face], -1)
    return shown


def write_labels(labeled: LabeledRecording, path: Path) -> None:
    """Write one compressed NumPy archive atomically."""
    document = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "name": labeled.name,
        "kind": labeled.kind,
        "frames": list(labeled.frames),
        "cameras": [_camera_document(one.camera) for one in labeled.pictures],
        "provenance": dict(labeled.provenance),
    }
    arrays = {
        "document": np.frombuffer(json.dumps(document, default=str).encode(), np.uint8),
        "rest_positions": np.asarray(labeled.mesh.vertices, np.float32),
        "faces": np.asarray(labeled.mesh.faces, np.int32),
        "canonical": np.asarray(labeled.mesh.canonical, np.float32),
    }
    for number, picture in enumerate(labeled.pictures):
        arrays[f"{number}/depth_m"] = np.where(picture.mask, picture.depth_m, 0).astype(np.float32)
        arrays[f"{number}/faces"] = picture.faces.astype(np.int32)
        arrays[f"{number}/positions"] = picture.positions.astype(np.float32)
    write_npz(path, arrays)


def read_labels(path: Path) -> LabeledRecording:
    """Read what `write_labels` has written; nothing in it is executed."""
    if not path.is_file():
        raise InvalidResultError(
            f"{path}: there are no such labels; make them with: clothtrack label TRACKED..."
        )
    try:
        return _labeled(read_npz(path))
    except (
        InvalidMeshError,
        InvalidRecordingError,
        InvalidResultError,
        LookupError,
        OSError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise InvalidResultError(
            f"{path}: not whole pseudo-labels of version {FORMAT_VERSION} ({error}); make them "
            "again with: clothtrack label TRACKED..."
        ) from error


def _labeled(arrays: Mapping[str, np.ndarray]) -> LabeledRecording:
    document = json.loads(arrays["document"].tobytes())
    found = document["format"], document["version"]
    if found != (FORMAT, FORMAT_VERSION):
        raise ValueError(f"format and version are {found}")
    mesh = ClothMesh(arrays["rest_positions"], arrays["faces"], arrays["canonical"])
    pictures = []
    for number, camera in enumerate(document["cameras"]):
        depth, faces = arrays[f"{number}/depth_m"], arrays[f"{number}/faces"]
        positions = arrays[f"{number}/positions"].astype(np.float64)
        _check_picture(depth, faces, positions, mesh)
        pictures.append(LabeledPicture(depth, depth > 0, _camera_of(camera), faces, positions))
    return LabeledRecording(
        document["name"],
        document["kind"],
        mesh,
        tuple(document["frames"]),
        tuple(pictures),
        document["provenance"],
    )


def _check_picture(
    depth: np.ndarray, faces: np.ndarray, positions: np.ndarray, mesh: ClothMesh
) -> None:
    if depth.shape != faces.shape or depth.ndim != 2:
        raise ValueError(f"depth is {depth.shape}, its labels are {faces.shape}")
    if positions.shape != (mesh.vertex_count, 3) or not np.isfinite(positions).all():
        raise ValueError(f"positions are {positions.shape} or not finite")
    if faces.dtype.kind != "i" or faces.max(initial=-1) >= len(mesh.faces):
        raise ValueError(f"a pixel shows face {faces.max()} of {len(mesh.faces)}")
    if not np.isfinite(depth).all():
        raise ValueError("a depth is not finite")
    for name, values in (("depth", depth), ("position", positions)):
        if (farthest := np.abs(values).max(initial=0.0)) > FARTHEST_M:
            raise ValueError(f"a {name} is {farthest:.3g} m, it must be within {FARTHEST_M:g} m")


def _camera_document(camera: Camera) -> dict[str, Any]:
    names = ("name", "width", "height", "fx", "fy", "cx", "cy")
    pose = camera.world_from_camera.tolist()
    return {**{name: getattr(camera, name) for name in names}, "world_from_camera": pose}


def _camera_of(document: Mapping[str, Any]) -> Camera:
    pose = np.array(document["world_from_camera"], np.float64)
    return Camera(**{**document, "world_from_camera": pose})
