"""Labels for fine-tuning: tracked meshes, the truth, the truth with errors, simulation."""

import hashlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from clothtrack.evaluation import Truth, material_map, material_points
from clothtrack.geometry import ClothMesh
from clothtrack.reconstruction.data.pseudo_labels import (
    LabeledRecording,
    PseudoLabel,
    label_recording,
)
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.recordings import read_recording
from clothtrack_lab.published_networks.rendered_state import render
from shared.bench_runs import Task, kept_labels

SMOOTH_M = 0.15
"""Length over which the error of a label that is made wrong changes [m]."""


def tracked_labels(task: Task) -> LabeledRecording:
    """Pseudo-labels of a finished run: the flat first frame, and the end of every action."""
    recording = read_recording(task.trajectory.recording)
    mesh, labels = kept_labels(task.file.with_suffix(".npz"))
    chosen = [PseudoLabel(0, mesh.vertices.astype(np.float64))]
    chosen += [PseudoLabel(one.frame, np.asarray(one.vertices, np.float64)) for one in labels]
    return label_recording(recording, mesh, chosen, kind=task.trajectory.kind)


def true_labels(task: Task) -> LabeledRecording:
    """Return the same frames on the same vertices, each where its piece of cloth really is."""
    trajectory = task.trajectory
    recording, truth = read_recording(trajectory.recording), Truth.load(trajectory.truth)
    mesh, labels = kept_labels(task.file.with_suffix(".npz"))
    where = material_map(truth.canonical, truth.faces, np.asarray(mesh.canonical, np.float64))
    chosen = [
        PseudoLabel(frame, material_points(truth.at(frame), truth.faces, where))
        for frame in (0, *(label.frame for label in labels))
    ]
    return label_recording(recording, mesh, chosen, kind=trajectory.kind)


def wrong_labels(task: Task, error_m: float, *, seed: int = 0) -> LabeledRecording:
    """Return the true labels with smooth errors along the table; the flat start stays right.

    Args:
        error_m: mean distance of a label's vertices from the truth [m].
    """
    true = true_labels(task)
    rng = np.random.default_rng([seed, *task.trajectory.name.encode()])
    labels = [PseudoLabel(true.frames[0], true.pictures[0].positions)]
    for frame, picture in zip(true.frames[1:], true.pictures[1:], strict=True):
        field = _smooth_field(np.asarray(true.mesh.canonical, np.float64), rng)
        field *= error_m / np.linalg.norm(field, axis=1).mean()
        moved = picture.positions + np.column_stack([field, np.zeros(len(field))])
        labels.append(PseudoLabel(frame, moved))
    recording = read_recording(task.trajectory.recording)
    return label_recording(recording, true.mesh, labels, kind=true.kind)


def simulated_labels(task: Task, *, seed: int = 0) -> LabeledRecording:
    """Return the meshes of a run drawn as the network's pretraining draws states: exact labels."""
    rng = np.random.default_rng([seed, *task.trajectory.name.encode()])
    mesh, labels = kept_labels(task.file.with_suffix(".npz"))
    states = [mesh.vertices, *(label.vertices for label in labels)]
    pictures = [render(np.asarray(each, np.float64), mesh, RenderConfig(), rng) for each in states]
    frames = (0, *(label.frame for label in labels))
    name = f"simulated_{task.trajectory.name}"
    return LabeledRecording(name, task.trajectory.kind, mesh, frames, tuple(pictures))


def _smooth_field(
    places: Float[np.ndarray, "vertices 3"], rng: np.random.Generator
) -> Float[np.ndarray, "vertices 2"]:
    """Return a random horizontal displacement that varies over `SMOOTH_M`: sixteen waves."""
    waves = rng.normal(0.0, 1.0 / SMOOTH_M, (3, 16))
    phases = rng.uniform(0.0, 2.0 * np.pi, 16)
    return np.cos(places @ waves + phases) @ rng.normal(size=(16, 2))


def label_mesh(task: Task, frame: int) -> ClothMesh | None:
    """Return the tracker's mesh at a frame that ended an action; None when it labeled another."""
    mesh, labels = kept_labels(task.file.with_suffix(".npz"))
    found = [label.vertices for label in labels if label.frame == frame]
    return mesh.with_vertices(np.asarray(found[0], np.float64)) if found else None


def digest_of(labels: Sequence[LabeledRecording]) -> str:
    """Return ten hexadecimal digits that change with any picture or label."""
    content = hashlib.sha256()
    for one in labels:
        content.update(f"{one.name} {one.kind} {one.frames}".encode())
        content.update(np.asarray(one.mesh.canonical, np.float32).tobytes())
        content.update(np.asarray(one.mesh.faces, np.int32).tobytes())
        for picture in one.pictures:
            for array in (picture.depth_m, picture.positions):
                content.update(np.asarray(array, np.float32).tobytes())
            content.update(picture.mask.tobytes())
            content.update(np.asarray(picture.faces, np.int32).tobytes())
    return content.hexdigest()[:10]
