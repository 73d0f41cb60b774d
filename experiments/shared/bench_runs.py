"""Runs of an experiment over a benchmark: trajectories, variants, and one row per mesh.

A run is one trajectory in one variant. Its rows are stored under the hash of everything that it
depends on, so that experiments share runs and an interrupted experiment can be resumed.
"""

import hashlib
import json
import os
import resource
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation.label_evidence import Label
from clothtrack.evaluation.truth import Truth
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.initial_state import find_initial_state
from clothtrack.tracking.pipeline import counted_settings, observer, provenance
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack.tracking.tracker import Tracker
from shared.ablations import ALL
from shared.bench_measures import ROW_FORMAT, Row, finite, measure
from shared.coherent_point_drift import PeerConfig, follow
from shared.first_meshes import resampled, with_first_mesh_error

BENCH_FILE = "bench.json"


@dataclass(frozen=True)
class Trajectory:
    """One recording of a benchmark, its truth, and the split it belongs to.

    Attributes:
        split: "dev", "test", "hard", or "" without splits.
        truth: the file that only the evaluation and the named controls read.
    """

    name: str
    kind: str
    split: str
    recording: Path
    truth: Path

    @property
    def digest(self) -> str:
        """Ten hexadecimal digits that change with what is measured, and with the truth."""
        return _content_digest(self.recording, self.truth)


@dataclass(frozen=True)
class Variant:
    """A tracking variant; every field except the name is part of the hash.

    Attributes:
        method: name of a method of `shared.ablations`; that of the settings' mode when empty.
        vertex_count: resample the first mesh to about so many vertices; None leaves it.
        first_mesh_error: factor on the first mesh's deviation from the truth. Any value but 1 is a
            control that reads the truth of the first frame, not a result.
        peer: whether to use the model-free baseline instead of the tracker.
    """

    name: str
    config: RunConfig = field(default_factory=RunConfig)
    method: str = ""
    vertex_count: int | None = None
    first_mesh_error: float = 1.0
    peer: PeerConfig | None = None

    @property
    def digest(self) -> str:
        """Twelve hexadecimal digits that change with every setting."""
        settings = {key: value for key, value in asdict(self).items() if key != "name"}
        settings["config"] = counted_settings(self.config)
        text = json.dumps(settings, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Task:
    """One run."""

    trajectory: Trajectory
    variant: Variant
    store: Path
    device: str = "cpu"

    @property
    def file(self) -> Path:
        """The run's rows; its meshes lie beside it with the suffix .npz."""
        key = f"{self.variant.digest}-{self.trajectory.digest}-{ROW_FORMAT}"
        return self.store / self.trajectory.name / f"{key}.jsonl"


@cache
def _content_digest(recording: Path, truth: Path) -> str:
    # The same actions filmed with another noise differ in nothing but their pictures.
    content = hashlib.sha256(truth.read_bytes())
    for file in sorted(each for each in recording.rglob("*") if each.is_file()):
        content.update(file.name.encode())
        content.update(file.read_bytes())
    return content.hexdigest()[:10]


def trajectories(
    bench: Path, split: str | None = None, limit: int | None = None
) -> list[Trajectory]:
    """Return the recordings of a benchmark folder whose truth is there too."""
    listed = bench / BENCH_FILE
    if listed.exists():
        entries = json.loads(listed.read_text(encoding="utf-8"))["trajectories"]
        labels = [(one["name"], one["kind"], one["split"]) for one in entries]
        labels = [label for label in labels if split in (None, label[2])]
    else:
        names = sorted(each.name for each in (bench / "recordings").glob("[!.]*"))
        labels = [(name, name.partition("_")[0], "") for name in names]
    found = [
        Trajectory(name, kind, of, bench / "recordings" / name, truth)
        for name, kind, of in labels
        if (truth := bench / "truth" / f"{name}.npz").exists()
    ]
    if not found:
        raise InvalidConfigError(f"{bench} has no recordings with truth in split {split!r}")
    turn: dict[str, int] = {}
    order = {}
    for each in found:
        order[each.name] = turn.get(each.kind, 0)
        turn[each.kind] = order[each.name] + 1
    return sorted(found, key=lambda each: (order[each.name], each.name))[:limit]


def run_all(
    tasks: Sequence[Task],
    *,
    workers: int = 1,
    ray: str = "",
    progress: Callable[[str], None] | None = None,
) -> list[list[Row]]:
    """Return the rows of every task, in order; finished runs are read, the others are made.

    A run that fails for a reason that the package can name gives one row with that `error`, which
    is not kept.
    """
    # Two names may stand for one run.
    missing = {task.file: task for task in tasks if not task.file.exists()}
    failed: dict[Path, list[Row]] = {}

    def note(task: Task, rows: list[Row]) -> None:
        if not task.file.exists():
            failed[task.file] = rows
        word = rows[0].get("error") or f"{rows[0]['cpu_s']:.0f} CPU s"
        if "memory_mb" in rows[0]:
            word = f"{word}, {rows[0]['memory_mb']:.0f} MB, {rows[0]['open_files']} open files"
        if progress is not None:
            progress(f"{task.variant.name}, {task.trajectory.name}: {word}\n")

    found = finished_in_workers(
        _made, list(missing.values()), workers, ray=ray, name=lambda task: str(task.file)
    )
    with closing(found) as made:
        for task, rows in made:
            note(task, rows)
    return [failed[task.file] if task.file in failed else read_rows(task.file) for task in tasks]


def _made(task: Task) -> tuple[Task, list[Row]]:
    return task, make(task)


def make(task: Task) -> list[Row]:
    """Track and measure; write the rows and the meshes, each whole or not at all."""
    trajectory, variant = task.trajectory, task.variant
    try:
        recording = read_recording(trajectory.recording)
        truth = Truth.load(trajectory.truth)
        recording = prepared(recording, truth, variant)
        clock = time.process_time()
        tracked = track(recording, variant, device=task.device)
        cpu_s = time.process_time() - clock
        rows = measure(tracked, recording, truth)
    except ClothTrackError as error:
        return [{"error": str(error)}]
    stamp = provenance_of(tracked, variant)
    effort = {"cpu_s": cpu_s, **process_state()}
    rows = [{**row, **effort, "provenance": stamp} for row in rows]
    task.file.parent.mkdir(parents=True, exist_ok=True)
    write_meshes(tracked, task.file.with_suffix(".npz"))
    write_rows(rows, task.file)
    return rows


def process_state() -> Row:
    """Return memory and open files of this process, to see growth (Linux; else 0)."""
    status, files = Path("/proc/self/statm"), Path("/proc/self/fd")
    pages = int(status.read_text("ascii").split()[1]) if status.exists() else 0
    return {
        "process": os.getpid(),
        "memory_mb": round(pages * resource.getpagesize() / 2**20, 1),
        "open_files": len(list(files.iterdir())) if files.exists() else 0,
    }


def prepared(recording: Recording, truth: Truth, variant: Variant) -> Recording:
    """Return the recording with the first mesh that the variant asks for."""
    if variant.vertex_count is not None:
        recording = resampled(recording, variant.vertex_count)
    if variant.first_mesh_error != 1.0:
        recording = with_first_mesh_error(recording, truth, variant.first_mesh_error)
    return recording


def track(recording: Recording, variant: Variant, *, device: str) -> TrackedTrajectory:
    """Track the cloth in a recording with the variant's settings."""
    config = variant.config
    cloud = observer(recording, config.cloud_spacing_m, color=config.color)
    first = find_initial_state(
        recording, cloud(recording.frames[0]), config.initial_state, device=device
    )
    if variant.peer is not None:
        tracked = follow(recording, first.mesh, cloud, variant.peer, device=device)
    else:
        tracker = Tracker(
            recording, first.mesh, config, cloud, start=first.positions,
            assemble=ALL[variant.method or config.mode], device=device,
        )  # fmt: skip
        tracked = tracker.track()
    stamp = provenance(recording, config, device)
    if variant.peer is not None:
        stamp = {**stamp, "peer": asdict(variant.peer)}
    return replace(tracked, config=asdict(config), provenance=stamp)


def provenance_of(tracked: TrackedTrajectory, variant: Variant) -> dict[str, object]:
    """Return commit, versions, seed and settings, but nothing that identifies the machine."""
    stamp = {key: value for key, value in tracked.provenance.items() if key != "machine"}
    return {**stamp, "config_hash": variant.digest}


def write_rows(rows: Iterable[Row], file: Path) -> None:
    """Write one JSON object per line, non-finite values as null; the file is complete or absent."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.{os.getpid()}.partial")
    lines = [json.dumps(finite(row), allow_nan=False) + "\n" for row in rows]
    temporary.write_text("".join(lines), encoding="utf-8")
    temporary.replace(file)


def read_rows(file: Path) -> list[Row]:
    """Return the rows of a file that `write_rows` has written."""
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines() if line]


def write_meshes(tracked: TrackedTrajectory, file: Path) -> None:
    """Write the meshes at the end of each action, before and after TTO2, for pictures."""
    temporary = file.with_name(f".{file.stem}.{os.getpid()}.partial.npz")
    np.savez_compressed(
        temporary,
        rest=tracked.mesh.vertices.astype(np.float32),
        faces=tracked.mesh.faces.astype(np.int32),
        canonical=np.asarray(tracked.mesh.canonical, np.float32),
        frames=np.array([action.last_frame for action in tracked.actions]),
        before=np.stack([a.positions_before_final_alignment for a in tracked.actions]),
        after=np.stack([a.positions_after_final_alignment for a in tracked.actions]),
    )
    temporary.replace(file)


def kept_labels(meshes: Path) -> tuple[ClothMesh, list[Label]]:
    """Return first mesh and labels of a run, from the meshes that it left."""
    kept = np.load(meshes)
    mesh = ClothMesh(kept["rest"].astype(np.float64), kept["faces"], kept["canonical"])
    after, before = kept["after"].astype(np.float64), kept["before"].astype(np.float64)
    labels = zip(kept["frames"].tolist(), after, before, strict=True)
    return mesh, [Label(*label) for label in labels]
