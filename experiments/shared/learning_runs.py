"""Runs of an experiment with the network: fine-tunings and reconstructions, kept and shared.

A fine-tuned network is stored under the hash of its training inputs: the initial weights, every
label and every setting. The rows of a reconstructed trajectory are stored under the hash of the
weights, the trajectory and the method of reconstruction. So experiments share common results, and
an interrupted one resumes, even in the middle of a training.
"""

import hashlib
import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation.truth import Truth
from clothtrack.files.settings import with_settings
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording, cloth_picture
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.design import Reconstructor as NetworkOfPictures
from clothtrack.reconstruction.from_picture import NetworkMesh
from clothtrack.reconstruction.model_loading import design_of, designs, load_model
from clothtrack.reconstruction.token_meshes import TokenMeshes
from clothtrack.reconstruction.tokens.token_learning import MODEL
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights, save_weights
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.pipeline import provenance
from clothtrack_lab.published_networks.model import MeshReconstructor
from clothtrack_lab.published_networks.network_config import TINY_NETWORK
from shared.bench_measures import Row
from shared.bench_runs import Task, Trajectory, kept_labels, read_rows, write_rows
from shared.learning_measures import LEARNING_ROW_FORMAT, Case, measure_reconstruction

DIGITS = 12


@dataclass(frozen=True)
class Reconstructor:
    """One way from a depth picture to a mesh; every field is part of the hash but the name."""

    name: str
    weights: Path
    method: str = "template"
    refined: bool = False
    vertex_count: int = 1000

    @property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with every setting and with the weights."""
        settings = {
            "weights": content_digest(self.weights),
            "method": self.method,
            "refined": self.refined,
            "vertex_count": self.vertex_count,
        }
        return _digest(settings)


@dataclass(frozen=True)
class Tuner:
    """How networks are fine-tuned, and where they are kept.

    Attributes:
        training: name of the training, of every design.
        settings: changes of its configuration; each design takes those of its own groups.
        held_out_share: of every stage; None: as the training says.
    """

    store: Path
    training: str = "finetune"
    settings: tuple[str, ...] = ()
    held_out_share: float | None = None
    seed: int = 0
    device: str = "cpu"

    def tuned(self, start: Path, labels: Sequence[LabeledRecording]) -> Path:
        """Return the weights after fine-tuning on these labels; trained where they are not kept."""
        folder = self.folder(start, labels)
        if not (folder / MODEL).exists():
            begun = load_weights(start)
            config = self.config_of(begun)
            outcome = design_of(begun).finetune(
                begun,
                labels,
                config,
                folder,
                processes=Processes(device=self.device),
            )
            if outcome.model is None:
                raise InvalidConfigError(
                    f"{folder}: the fine-tuning was interrupted; the same command goes on from "
                    "there"
                )
        return folder / MODEL

    def config_of(self, start: Weights) -> Any:
        """Return how a network that begins with these weights is trained."""
        config = design_of(start).configuration(self.training, seed=self.seed)
        loops = [one.name for one in fields(config) if _is_loop(getattr(config, one.name))]
        if self.held_out_share is not None:
            share = self.held_out_share
            changed = {one: replace(getattr(config, one), held_out_share=share) for one in loops}
            config = replace(config, **changed)
        others = {
            one.name for design in designs() for one in fields(design.configuration(self.training))
        } - {one.name for one in fields(config)}
        own = [one for one in self.settings if one.partition(".")[0] not in others]
        return with_settings(config, own)

    def folder(self, start: Path, labels: Sequence[LabeledRecording]) -> Path:
        """Return the folder of the network trained from these weights on these labels."""
        config = self.config_of(load_weights(start))
        settings: dict[str, object] = {
            "start": content_digest(start),
            "labels": digest_of(labels),
            "config": asdict(config),
        }
        return self.store / labels[0].kind / _digest(settings)


def _is_loop(value: object) -> bool:
    return isinstance(value, TrainingConfig)


def content_digest(path: Path) -> str:
    """Return ten hexadecimal digits of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:10]


def _digest(settings: object) -> str:
    text = json.dumps(settings, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def kind_of(weights: Path) -> str:
    """Return the garment that weights are for."""
    return load_weights(weights).kind


def reconstruct_frame(
    model: NetworkOfPictures,
    recording: Recording,
    frame: int,
    kind: str,
    how: Reconstructor,
) -> NetworkMesh:
    """Return the network's mesh for one frame of a recording.

    The token network is given the garment as in its normal use, by the recording's own template if
    it has one. The published network is given only the kind.
    """
    depth, mask, camera = cloth_picture(recording, recording.frames[frame])
    told = recording.cloth.template if isinstance(model, TokenMeshes) else None
    return model.mesh(
        DepthInput(depth, mask, camera, recording.table, kind),
        kind,
        method=how.method,
        template=told,
        vertex_count=how.vertex_count,
        refined=how.refined,
    )


def reconstruction_rows(
    trajectory: Trajectory, how: Reconstructor, store: Path, *, label: Task | None = None
) -> list[Row]:
    """Return the rows of a trajectory's actions, each reconstructed from its last frame alone."""
    judged = "" if label is None else f"-{label.variant.digest}"
    key = f"{how.digest}-{trajectory.digest}{judged}-{LEARNING_ROW_FORMAT}"
    file = store / trajectory.name / f"{key}.jsonl"
    if file.exists():
        return read_rows(file)
    try:
        rows = _measured(trajectory, how, label)
    except ClothTrackError as error:
        return [{"error": str(error)}]
    write_rows(rows, file)
    return rows


def _measured(trajectory: Trajectory, how: Reconstructor, label: Task | None) -> list[Row]:
    recording, truth = read_recording(trajectory.recording), Truth.load(trajectory.truth)
    model = load_model(trajectory.kind, how.weights)
    stamp = provenance(recording, RunConfig(), "cpu")
    stamp = {key: value for key, value in stamp.items() if key != "machine"}
    stamp = {**stamp, "config_hash": how.digest, "weights": content_digest(how.weights)}
    rows = []
    for number, action in enumerate(recording.actions):
        frame = action.last_frame
        known = None if label is None else label_mesh(label, frame)
        clock = time.process_time()
        found = reconstruct_frame(model, recording, frame, trajectory.kind, how)
        cpu_s = time.process_time() - clock
        case = Case(recording, truth, frame, trajectory.kind, known)
        rows.append(
            {
                "action": number + 1,
                "actions": len(recording.actions),
                "stage": "after",
                **measure_reconstruction(found, case),
                "cpu_s": cpu_s,
                "provenance": stamp,
            }
        )
    return rows


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


def tiny_network(path: Path, kind: str = "towel") -> Path:
    """Return a network that has learned nothing, small enough for a smoke run."""
    import torch

    if not path.exists():
        torch.manual_seed(0)
        save_weights(
            path, MeshReconstructor(TINY_NETWORK, kind).state_dict(), TINY_NETWORK, kind=kind
        )
    return path
