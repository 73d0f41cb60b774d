"""Result of tracking: the full mesh at every observation, with records of how it was found.

A trajectory is one Zarr v3 group. It is written under a temporary name and renamed, so that a
group under its final name is complete. A resumed run skips recordings with a finished group.
Damaged chunks are refused by their CRC-32C.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from jaxtyping import Bool, Float, Int

from clothtrack._shown import short_repr
from clothtrack.errors import InvalidMeshError, InvalidResultError
from clothtrack.files.arrays import DAMAGE, put_array, take_array
from clothtrack.files.atomic_write import atomic_folder, name_problem
from clothtrack.geometry.mesh import ClothMesh

FORMAT = "clothtrack-tracked-trajectory"
FORMAT_VERSION = 2

_UNITS_OF_STEPS = {
    "loss_before": "m^2",
    "loss_after": "m^2",
    "highest_speed": "m/s",
    "predict_s": "s",
    "align_s": "s",
    "correct_s": "s",
}


@dataclass(frozen=True, eq=False)
class Calibration:
    """Record of how the cloth parameters of one action were found (paper, Sec. III-B.1).

    Attributes:
        names: the calibrated parameters, in the order of `candidates`' columns.
        candidates: every combination that was rolled out to the end.
        scores: score of each candidate, lower is better: Chamfer distance [m^2] of an open-loop
            roll-out to the last cloud, or gap of the tracked outline (0 to 1).
        best: index of the chosen candidate, -1 if nothing was calibrated.
        judge: "open_loop" or "tracking": the kind of the scores.
        spread_m: spread of the tracked candidates' final positions at each vertex, as the mean
            distance from their mean [m]; empty if fewer than two were tracked. It is large where
            the cloud does not determine the cloth.
    """

    method: str
    names: tuple[str, ...]
    candidates: Float[np.ndarray, "candidates parameters"]
    scores: Float[np.ndarray, " candidates"]
    best: int
    roll_outs: float
    judge: str = "open_loop"
    spread_m: Float[np.ndarray, " vertices"] = field(default_factory=lambda: np.zeros(0))

    __repr__ = short_repr

    @classmethod
    def none(cls) -> "Calibration":
        """Return the record of an action without a search."""
        return cls("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)


@dataclass(frozen=True, eq=False)
class TrackedAction:
    """One tracked pick-and-place.

    Attributes:
        positions_before_final_alignment: mesh at the last frame before TTO2 [m].
        positions_after_final_alignment: mesh at the last frame after TTO2 [m]: the pseudo-label.
        final_alignment_losses: objective [m^2] of TTO2 at its start and end; NaN without TTO2.
        parameters: the cloth parameters that were used, by name.
        held_vertices: the vertices that each picker held, by picker name.
    """

    first_frame: int
    last_frame: int
    positions_before_final_alignment: Float[np.ndarray, "vertices 3"]
    positions_after_final_alignment: Float[np.ndarray, "vertices 3"]
    final_alignment_losses: Float[np.ndarray, " 2"]
    parameters: Mapping[str, float]
    calibration: Calibration
    held_vertices: Mapping[str, tuple[int, ...]]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class StepRecords:
    """Records of each frame; NaN, 0 or False for frames that were not simulated.

    Attributes:
        loss_before: objective [m^2] of TTO1 at the predicted mesh.
        loss_after: objective [m^2] of TTO1 at its end.
        correction_scale: accepted scale of the correction; 0 if it was dropped.
        gave_up: whether the line search ran out of trials and dropped the pseudo-action.
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

    __repr__ = short_repr

    @classmethod
    def empty(cls, frame_count: int) -> "StepRecords":
        """Return the empty records of a new trajectory."""
        blank = {name: np.full(frame_count, np.nan, np.float32) for name in cls.__annotations__}
        blank["trials"] = np.zeros(frame_count, np.int32)
        blank["gave_up"] = np.zeros(frame_count, bool)
        return cls(**blank)

    def adopt(self, other: "StepRecords", frames: slice) -> None:
        """Copy these frames from another record."""
        for name in self.__annotations__:
            getattr(self, name)[frames] = getattr(other, name)[frames]


@dataclass(frozen=True, eq=False)
class TrackedTrajectory:
    """A full mesh, hidden layers included, for every observation of a recording.

    Attributes:
        mesh: the first mesh: topology, rest shape and canonical coordinates.
        time_s: times of the frames [s].
        positions: vertex positions in the world [m]; at the last frame of an action they are those
            after the final alignment.
        provenance: versions, commit, seed, device, the recording's own provenance.
        verdict_fields: the verdict and its reasons, as written by `evaluation.Verdict.as_dict`;
            empty if the trajectory was not judged.
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
    verdict_fields: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frames_after_last_action(self) -> Int[np.ndarray, " _"]:
        """Untracked frames after the last action; their mesh is that of its last frame."""
        return self.frames[self.frames > self.actions[-1].last_frame if self.actions else slice(0)]

    def save(self, path: Path | str) -> None:
        """Write the Zarr group completely or not at all."""
        with atomic_folder(Path(path), replace=True) as temporary:
            _write(zarr.open_group(temporary, mode="w"), self)

    def __repr__(self) -> str:
        """Return one line, without the positions."""
        frames, vertices = self.positions.shape[:2]
        return (
            f"{type(self).__name__}({self.name!r}, {frames} frames, {vertices} vertices, "
            f"{len(self.actions)} actions)"
        )

    @classmethod
    def load(cls, path: Path | str) -> "TrackedTrajectory":
        """Read a group that `save` has written."""
        path = Path(path)
        if not (path / "zarr.json").is_file():
            remedy = "make one with: clothtrack track RECORDING --output FOLDER"
            if any(path.glob("*.zarr")):
                remedy = f"name those in it: {path}/*.zarr"
            raise InvalidResultError(f"{path} is not a tracked trajectory (no zarr.json); {remedy}")
        try:
            return _read(zarr.open_group(path, mode="r", zarr_format=3))
        except (InvalidResultError, InvalidMeshError, *DAMAGE) as error:
            # Messages of Zarr and its codecs may have several lines.
            text = " ".join(str(error).split())
            raise InvalidResultError(
                f"{path}: not a whole tracked trajectory ({text}); remove it and track the "
                "recording again"
            ) from error


def _put(group: zarr.Group, name: str, values: np.ndarray, *, unit: str = "") -> None:
    values = np.asarray(values)
    chunks = (1, *values.shape[1:]) if values.ndim == 3 else None
    put_array(group, name, values, unit=unit, chunks=chunks)


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
        _put(steps, name, getattr(tracked.steps, name), unit=_UNITS_OF_STEPS.get(name, ""))
    for number, action in enumerate(tracked.actions):
        part = group.create_group(f"actions/{number}")
        for name in ("positions_before_final_alignment", "positions_after_final_alignment"):
            _put(part, name, getattr(action, name).astype(np.float32), unit="m")
        _put(part, "final_alignment_losses", action.final_alignment_losses, unit="m^2")
        _put(part, "calibration_candidates", action.calibration.candidates)
        unit = "m^2" if action.calibration.judge == "open_loop" else "1"
        _put(part, "calibration_scores", action.calibration.scores, unit=unit)
        _put(part, "calibration_spread", action.calibration.spread_m.astype(np.float32), unit="m")
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
    group.attrs.update(
        {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "name": tracked.name,
            "action_count": len(tracked.actions),
            "config": dict(tracked.config),
            "provenance": dict(tracked.provenance),
            "verdict": dict(tracked.verdict_fields),
        }
    )


def _read(group: zarr.Group) -> TrackedTrajectory:
    stored = group.attrs.get("format"), group.attrs.get("version")
    if stored[0] != FORMAT:
        raise InvalidResultError(
            f"its format is {stored[0]!r:.80}, expected {FORMAT!r}: it was not finished or is "
            "something else"
        )
    if stored[1] != FORMAT_VERSION:
        raise InvalidResultError(
            f"it is of version {stored[1]!r:.80}, this clothtrack reads {FORMAT_VERSION}: another "
            "one wrote it"
        )
    attributes = group.attrs.asdict()
    if problem := name_problem(attributes["name"]):
        raise InvalidResultError(f"its name is {attributes['name']!r:.80}: {problem}")
    attributes.setdefault("verdict", {})  # missing in groups from before it was stored
    for named in ("config", "provenance", "verdict"):
        if not isinstance(attributes[named], dict):
            raise InvalidResultError(
                f"its {named} is {attributes[named]!r:.80}, it must be a set of named values"
            )
    canonical = take_array(group, "canonical") if "canonical" in group else None
    mesh = ClothMesh(take_array(group, "rest_positions"), take_array(group, "faces"), canonical)
    frames = take_array(group, "frames")
    count = len(frames)
    return TrackedTrajectory(
        name=attributes["name"],
        mesh=mesh,
        frames=frames,
        time_s=_take(group, "time_s", count),
        positions=_take_positions(group, "positions", count, mesh.vertex_count),
        visible=_take(group, "visible", count, mesh.vertex_count),
        actions=tuple(
            _read_action(group, number, mesh, frames)
            for number in range(attributes["action_count"])
        ),
        steps=StepRecords(
            **{name: _take(group, f"steps/{name}", count) for name in StepRecords.__annotations__}
        ),
        config=attributes["config"],
        provenance=attributes["provenance"],
        verdict_fields=attributes["verdict"],
    )


def _read_action(
    group: zarr.Group, number: int, mesh: ClothMesh, frames: Int[np.ndarray, " frames"]
) -> TrackedAction:
    place = f"actions/{number}"
    attributes: dict[str, Any] = group[place].attrs.asdict()
    calibration = attributes["calibration"]
    first, last = attributes["first_frame"], attributes["last_frame"]
    if not (type(first) is type(last) is int and frames[0] <= first <= last <= frames[-1]):
        raise InvalidResultError(
            f"action {number} lasts from frames {first} to {last}; it must be in {frames[0]} to "
            f"{frames[-1]}"
        )
    before, after = (
        _take_positions(group, f"{place}/positions_{when}_final_alignment", mesh.vertex_count)
        for when in ("before", "after")
    )
    return TrackedAction(
        first_frame=first,
        last_frame=last,
        positions_before_final_alignment=before,
        positions_after_final_alignment=after,
        final_alignment_losses=_take(group, f"{place}/final_alignment_losses", 2),
        parameters=attributes["parameters"],
        calibration=Calibration(
            calibration["method"],
            tuple(calibration["names"]),
            take_array(group, f"{place}/calibration_candidates"),
            take_array(group, f"{place}/calibration_scores"),
            calibration["best"],
            calibration["roll_outs"],
            calibration["judge"],
            _take_spread(group, f"{place}/calibration_spread", mesh.vertex_count),
        ),
        held_vertices={k: tuple(v) for k, v in attributes["held_vertices"].items()},
    )


def _take(group: zarr.Group, name: str, *shape: int) -> np.ndarray:
    values = take_array(group, name)
    if values.shape != shape:
        raise InvalidResultError(f"array {name} has shape {values.shape}, it must have {shape}")
    if values.dtype.kind not in "biuf":
        raise InvalidResultError(f"array {name} holds {values.dtype}, it must hold numbers")
    return values


def _take_spread(group: zarr.Group, name: str, vertices: int) -> np.ndarray:
    """Return the spread; empty if nothing was searched or the group predates the spread."""
    if name not in group:
        return np.zeros(0)
    values = take_array(group, name)
    return _take(group, name, vertices if values.size else 0).astype(np.float64)


def _take_positions(group: zarr.Group, name: str, *counts: int) -> np.ndarray:
    positions = _take(group, name, *counts, 3)
    if not np.isfinite(positions).all():
        raise InvalidResultError(f"array {name} is not finite")
    return positions
