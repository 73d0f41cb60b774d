"""What the tracker leaves behind: the full mesh at every observation, and how it came about.

One Zarr v3 group per trajectory. It is written under a temporary name and renamed, so that a
group under its final name is whole; a finished group is the mark by which a run resumes.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int

from clothtrack.errors import InvalidResultError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.storing import whole_folder

FORMAT = "clothtrack-tracked-trajectory"
FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class Calibration:
    """How the cloth parameters of one action were found (paper, Sec. III-B.1).

    Attributes:
        method: "none", "grid", "halving" or "descent".
        names: the calibrated parameters, in the order of `candidates`' columns.
        candidates: every combination that was rolled out to the end.
        scores: of each candidate, lower is better: Chamfer distance [m^2] of an open-loop roll-out
            against the clouds of the action, or gap of the tracked outline (0 to 1).
        best: index of the chosen candidate, -1 when nothing was calibrated.
        roll_outs: full roll-outs spent, early-stopped ones counted by the share they ran.
        judge: "open_loop" or "tracking": what the scores are.
    """

    method: str
    names: tuple[str, ...]
    candidates: Float[np.ndarray, "candidates parameters"]
    scores: Float[np.ndarray, " candidates"]
    best: int
    roll_outs: float
    judge: str = "open_loop"


@dataclass(frozen=True, eq=False)
class TrackedAction:
    """One pick-and-place, tracked.

    Attributes:
        first_frame: where it starts.
        last_frame: where it ends, inclusive.
        positions_before_final_alignment: mesh at the last frame before TTO2 [m].
        positions_after_final_alignment: mesh at the last frame after TTO2 [m]: the pseudo-label.
        final_alignment_losses: objective [m^2] of TTO2 at its start and end; NaN without TTO2.
        parameters: the cloth parameters that were used, by name.
        calibration: all candidates and their scores.
        held_vertices: the vertices each picker held, by picker name.
    """

    first_frame: int
    last_frame: int
    positions_before_final_alignment: Float[np.ndarray, "vertices 3"]
    positions_after_final_alignment: Float[np.ndarray, "vertices 3"]
    final_alignment_losses: Float[np.ndarray, " 2"]
    parameters: Mapping[str, float]
    calibration: Calibration
    held_vertices: Mapping[str, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class StepRecords:
    """What happened at each frame; NaN, 0 or False where a frame was not stepped into.

    Attributes:
        loss_before: objective [m^2] of TTO1 at the predicted mesh.
        loss_after: objective [m^2] of TTO1 at its end.
        trials: roll-outs tried with a pseudo-action.
        correction_scale: factor of the correction that was accepted; 0 when it was dropped.
        gave_up: the line search ran out of trials and the pseudo-action was dropped.
        highest_speed: fastest vertex [m/s] of the accepted roll-out, before the speed limit.
        predict_s: CPU time of the dynamics roll-out [s].
        align_s: CPU time of TTO1 with its visibility [s].
        correct_s: CPU time of the roll-outs with a pseudo-action [s].
    """

    loss_before: Float[np.ndarray, " frames"]
    loss_after: Float[np.ndarray, " frames"]
    trials: Int[np.ndarray, " frames"]
    correction_scale: Float[np.ndarray, " frames"]
    gave_up: Bool[np.ndarray, " frames"]
    highest_speed: Float[np.ndarray, " frames"]
    predict_s: Float[np.ndarray, " frames"]
    align_s: Float[np.ndarray, " frames"]
    correct_s: Float[np.ndarray, " frames"]

    @classmethod
    def empty(cls, frame_count: int) -> "StepRecords":
        """Records of a trajectory in which nothing has happened yet."""
        blank = {name: np.full(frame_count, np.nan, np.float32) for name in cls.__annotations__}
        blank["trials"] = np.zeros(frame_count, np.int32)
        blank["gave_up"] = np.zeros(frame_count, bool)
        return cls(**blank)

    def adopt(self, other: "StepRecords", frames: slice) -> None:
        """Take these frames from another record."""
        for name in self.__annotations__:
            getattr(self, name)[frames] = getattr(other, name)[frames]


@dataclass(frozen=True, eq=False)
class TrackedTrajectory:
    """A full mesh, hidden layers included, for every observation of a recording.

    Attributes:
        name: the recording's name.
        mesh: the first mesh: topology, rest shape and canonical coordinates.
        frames: frame indices of the recording.
        time_s: when they were [s].
        positions: vertex positions in the world [m]; at the last frame of an action they are those
            after the final alignment.
        visible: whether some camera sees the vertex.
        actions: one record per action.
        steps: one record per frame.
        config: the whole configuration of the run.
        provenance: versions, commit, seed, device, the recording's own provenance.
    """

    name: str
    mesh: ClothMesh
    frames: Int[np.ndarray, " frames"]
    time_s: Float[np.ndarray, " frames"]
    positions: Float[np.ndarray, "frames vertices 3"]
    visible: Bool[np.ndarray, "frames vertices"]
    actions: tuple[TrackedAction, ...]
    steps: StepRecords
    config: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write the Zarr group, whole or not at all.

        Raises:
            StorageError: when the disk refuses; nothing is left under `path` then.
        """
        with whole_folder(path, replace=True) as temporary:
            _write(zarr.open_group(temporary, mode="w"), self)

    @classmethod
    def load(cls, path: Path) -> "TrackedTrajectory":
        """Read a group that `save` has written.

        Raises:
            InvalidResultError: when it is missing, unfinished, or from another version.
        """
        if not (path / "zarr.json").is_file():
            raise InvalidResultError(
                f"{path} is not a tracked trajectory (no zarr.json); "
                "make one with: clothtrack track RECORDING --output FOLDER"
            )
        try:
            return _read(zarr.open_group(path, mode="r"), path)
        except (KeyError, ValueError, TypeError, json.JSONDecodeError) as error:
            raise InvalidResultError(
                f"{path}: cannot be read as a tracked trajectory ({error}); track it again"
            ) from error


def _put(group: zarr.Group, name: str, values: np.ndarray, *, unit: str = "") -> None:
    values = np.asarray(values)
    chunks = (1, *values.shape[1:]) if values.ndim == 3 else values.shape
    array = group.create_array(
        name, shape=values.shape, dtype=values.dtype, chunks=tuple(max(1, n) for n in chunks)
    )
    array[...] = values
    if unit:
        array.attrs["unit"] = unit


def _write(group: zarr.Group, tracked: TrackedTrajectory) -> None:
    _put(group, "rest_positions", tracked.mesh.vertices.astype(np.float32), unit="m")
    _put(group, "faces", tracked.mesh.faces.astype(np.int32))
    if tracked.mesh.canonical is not None:
        _put(group, "canonical", tracked.mesh.canonical.astype(np.float32), unit="m")
    _put(group, "frames", tracked.frames)
    _put(group, "time_s", tracked.time_s, unit="s")
    _put(group, "positions", tracked.positions.astype(np.float32), unit="m")
    _put(group, "visible", tracked.visible)
    steps = group.create_group("steps")
    for name in StepRecords.__annotations__:
        _put(steps, name, getattr(tracked.steps, name))
    for number, action in enumerate(tracked.actions):
        part = group.create_group(f"actions/{number}")
        for name in ("positions_before_final_alignment", "positions_after_final_alignment"):
            _put(part, name, getattr(action, name).astype(np.float32), unit="m")
        _put(part, "final_alignment_losses", action.final_alignment_losses, unit="m^2")
        _put(part, "calibration_candidates", action.calibration.candidates)
        unit = "m^2" if action.calibration.judge == "open_loop" else "1"
        _put(part, "calibration_scores", action.calibration.scores, unit=unit)
        part.attrs.update(
            {
                "first_frame": action.first_frame,
                "last_frame": action.last_frame,
                "parameters": dict(action.parameters),
                "held_vertices": {k: list(v) for k, v in action.held_vertices.items()},
                "calibration": {
                    "method": action.calibration.method,
                    "names": list(action.calibration.names),
                    "best": action.calibration.best,
                    "roll_outs": action.calibration.roll_outs,
                    "judge": action.calibration.judge,
                },
            }
        )
    # Attributes last: a group without them was not finished.
    group.attrs.update(
        {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "name": tracked.name,
            "action_count": len(tracked.actions),
            "config": dict(tracked.config),
            "provenance": dict(tracked.provenance),
        }
    )


def _read(group: zarr.Group, path: Path) -> TrackedTrajectory:
    if group.attrs.get("format") != FORMAT:
        raise InvalidResultError(
            f"{path}: format is {group.attrs.get('format')!r}, expected {FORMAT!r}; "
            "the group was not finished or is something else"
        )
    if group.attrs["version"] != FORMAT_VERSION:
        raise InvalidResultError(
            f"{path}: version {group.attrs['version']} (this clothtrack reads {FORMAT_VERSION}); "
            "upgrade clothtrack or track the recording again"
        )
    canonical = group["canonical"][...] if "canonical" in group else None
    return TrackedTrajectory(
        name=group.attrs["name"],
        mesh=ClothMesh(group["rest_positions"][...], group["faces"][...], canonical),
        frames=group["frames"][...],
        time_s=group["time_s"][...],
        positions=group["positions"][...],
        visible=group["visible"][...],
        actions=tuple(
            _read_action(group[f"actions/{number}"])
            for number in range(group.attrs["action_count"])
        ),
        steps=StepRecords(**{n: group[f"steps/{n}"][...] for n in StepRecords.__annotations__}),
        config=group.attrs["config"],
        provenance=group.attrs["provenance"],
    )


def _read_action(part: zarr.Group) -> TrackedAction:
    calibration: Any = part.attrs["calibration"]
    return TrackedAction(
        first_frame=part.attrs["first_frame"],
        last_frame=part.attrs["last_frame"],
        positions_before_final_alignment=part["positions_before_final_alignment"][...],
        positions_after_final_alignment=part["positions_after_final_alignment"][...],
        final_alignment_losses=part["final_alignment_losses"][...],
        parameters=part.attrs["parameters"],
        calibration=Calibration(
            calibration["method"],
            tuple(calibration["names"]),
            part["calibration_candidates"][...],
            part["calibration_scores"][...],
            calibration["best"],
            calibration["roll_outs"],
            # Results of versions that knew no other judge do not name it.
            calibration.get("judge", "open_loop"),
        ),
        held_vertices={k: tuple(v) for k, v in dict(part.attrs["held_vertices"]).items()},
    )
