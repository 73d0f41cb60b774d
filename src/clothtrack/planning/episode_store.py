"""One flattening episode on disk, written step by step so that it can be resumed.

    EPISODE/episode.json       settings, software versions and each finished step
    EPISODE/steps/00           the cloth before any action, as a recording of one frame
    EPISODE/steps/01 ...       each action as a recording of its own
    EPISODE/estimates/00.npz   estimated cloth state after each step

At the end the steps are joined to one normal recording. The truth of a simulated robot is not
stored here.
"""

import json
import shutil
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import InvalidResultError
from clothtrack.files.atomic_write import atomic_file, storage, write_file
from clothtrack.files.provenance import as_plain, made_with, require_same
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.perception import Estimate
from clothtrack.planning.robots.robot import Execution, RgbdFrame
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import ClothDescription, PickerPath, Recording, Table
from clothtrack.recordings.store import RecordingWriter, read_recording

DOCUMENT = "episode.json"
PICKER = "gripper"
_DEPTH_UNIT_M = 0.0005
PACKAGES = ("numpy", "scipy", "warp-lang", "mujoco-core", "torch")


class EpisodeStore:
    """Reader and writer of the parts of one episode."""

    def __init__(
        self, folder: Path, asked: Mapping[str, Any], *, weights: Mapping[str, Path] | None = None
    ) -> None:
        """Begin an episode, or resume the one in the folder."""
        self.folder = Path(folder)
        path = self.folder / DOCUMENT
        if not path.exists():
            names = {name: weights_file.name for name, weights_file in (weights or {}).items()}
            self.document: dict[str, Any] = {
                "asked": as_plain(asked),
                "made_with": {**made_with(PACKAGES), "weights": names},
                "status": "running",
                "steps": [],
            }
            self.write()
            return
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            parts = ("asked", "made_with", "status", "steps")
            self.document = {name: document[name] for name in parts}
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise InvalidResultError(
                f"{path}: not an episode ({error}); remove its folder and begin again"
            ) from error
        require_same(path, self.document["asked"], asked)

    @property
    def steps(self) -> list[dict[str, Any]]:
        """The finished steps; the first is the cloth before any action."""
        return self.document["steps"]

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.document["status"] != "running"

    def write(self) -> None:
        """Write `episode.json`, whole or not at all."""
        write_file(self.folder / DOCUMENT, json.dumps(self.document, indent=1).encode())

    def recording_path(self, step: int) -> Path:
        """Return the path of a step's recording."""
        return self.folder / "steps" / f"{step:02d}"

    def clear_after(self, step: int) -> None:
        """Remove the files of steps after this one, which were never finished."""
        with storage(self.folder):
            for path in sorted((self.folder / "steps").glob("*")):
                if path.name.startswith(".") or int(path.name) > step:
                    shutil.rmtree(path)

    def add_estimate(self, step: int, estimate: Estimate) -> None:
        """Write the estimate after a step, whole or not at all."""
        arrays = {
            "sources": np.array([estimate.source]),
            "flat_0": estimate.flat.vertices,
            "faces_0": estimate.flat.faces,
            "positions_0": estimate.positions,
        }
        if estimate.opposite is not None:
            arrays["opposite_0"] = estimate.opposite
        if estimate.flat.canonical is not None:
            arrays["canonical_0"] = estimate.flat.canonical
        with atomic_file(self.folder / "estimates" / f"{step:02d}.npz") as unfinished:
            np.savez_compressed(unfinished, **arrays)

    def estimate(self, step: int) -> Estimate | None:
        """Return the estimate after a step; None if there is none.

        If an episode was planned from several estimates, return the first.
        """
        path = self.folder / "estimates" / f"{step:02d}.npz"
        if not path.exists():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                canonical = file["canonical_0"] if "canonical_0" in file.files else None
                flat = ClothMesh(file["flat_0"], file["faces_0"], canonical)
                opposite = file["opposite_0"] if "opposite_0" in file.files else None
                source = str(file["sources"][0])
                return Estimate(flat, file["positions_0"], source, opposite=opposite)
        except (OSError, ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile) as error:
            raise InvalidResultError(
                f"{path}: not the estimate of a step ({error}); remove the episode"
            ) from error

    def joined(self, out: Path, provenance: Mapping[str, Any]) -> Path:
        """Write all steps as one recording for the tracker, unless it exists."""
        if (out / "recording.json").exists():
            return out
        parts = [read_recording(self.recording_path(step)) for step in range(len(self.steps))]
        first = parts[0]
        paths = [part.picker_paths[PICKER] for part in parts if PICKER in part.picker_paths]
        with RecordingWriter(
            out, first.cameras, first.depth_units_m, table=first.table, cloth=first.cloth,
            observed=first.observed, provenance=dict(provenance),
        ) as writer:  # fmt: skip
            count, begun = 0, first.frames[0].time_s
            for part in parts:
                start = count
                for frame in part.frames:
                    _copy(writer, part, frame.index, frame.time_s - begun)
                    count += 1
                if part.actions:
                    writer.add_action(start, count - 1, [PICKER])
            if paths:
                writer.set_picker_path(
                    PICKER,
                    PickerPath(
                        np.concatenate([path.time_s for path in paths]) - begun,
                        np.concatenate([path.positions for path in paths]),
                        np.concatenate([path.closed for path in paths]),
                    ),
                )
        return out


def write_step(
    folder: Path,
    frames: Sequence[RgbdFrame],
    *,
    cloth: ClothDescription,
    table: Table,
    execution: Execution | None = None,
    provenance: Mapping[str, object] | None = None,
) -> Recording:
    """Write one step as a recording and read it back."""
    camera = frames[0].camera
    with RecordingWriter(
        folder, [camera], {camera.name: _DEPTH_UNIT_M}, table=table, cloth=cloth,
        provenance=dict(provenance or {}),
    ) as writer:  # fmt: skip
        for frame in frames:
            writer.add_frame(
                frame.time_s,
                color=None if frame.color is None else {camera.name: frame.color},
                depth={camera.name: frame.depth_m},
            )
        if execution is not None:
            writer.set_picker_path(PICKER, _covering(execution.path, frames))
            writer.add_action(0, len(frames) - 1, [PICKER])
    return read_recording(folder)


def _covering(path: PickerPath, frames: Sequence[RgbdFrame]) -> PickerPath:
    """Return the path extended at both ends, with the tip at rest, to cover all pictures."""
    times, tips, closed = path.time_s, path.positions, path.closed
    if frames[0].time_s < times[0]:
        times = np.concatenate([[frames[0].time_s], times])
        tips, closed = np.vstack([tips[:1], tips]), np.concatenate([[False], closed])
    if frames[-1].time_s > times[-1]:
        times = np.concatenate([times, [frames[-1].time_s]])
        tips, closed = np.vstack([tips, tips[-1:]]), np.concatenate([closed, [False]])
    return PickerPath(times, tips, closed)


def _copy(writer: RecordingWriter, part: Recording, index: int, time_s: float) -> None:
    frame = part.frames[index]
    writer.add_frame(
        time_s,
        color={name: read_color(path) for name, path in frame.color.items()} or None,
        depth={
            name: read_depth(path, part.depth_units_m[name]) for name, path in frame.depth.items()
        },
    )
