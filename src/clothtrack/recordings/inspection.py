"""What a recording holds and what is wrong with it: the result of `clothtrack inspect`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack._shown import short_repr
from clothtrack.errors import ClothTrackError
from clothtrack.recordings.geometry_checks.checks import check_geometry
from clothtrack.recordings.geometry_checks.finding import Finding, reaches_rim
from clothtrack.recordings.pictures import read_depth
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.validation import check_recording
from clothtrack.recordings.violation import Violation, grouped

_LISTED = 20


@dataclass(frozen=True)
class Inspection:
    """The contents of a recording, and what is wrong with it.

    Attributes:
        folder: folder of the recording.
        facts: what it holds ("frames": "50, from 0 to 2.45 s"); empty when it cannot be read.
        notes: what is allowed but worth knowing before tracking.
        violations: everything that is wrong; empty for a valid recording.
        geometry: where the pictures of a valid recording contradict it; empty for a right one.
    """

    folder: Path
    facts: Mapping[str, str]
    notes: tuple[str, ...]
    violations: tuple[Violation, ...]
    geometry: tuple[Finding, ...] = ()

    __repr__ = short_repr

    @property
    def valid(self) -> bool:
        """Whether the recording can be read and tracked."""
        return not self.violations

    @property
    def ok(self) -> bool:
        """The same, under the name that everything inspected has."""
        return self.valid

    def text(self) -> str:
        """Return the inspection for a person, in at most some 40 lines."""
        if self.violations:
            count = len(self.violations)
            lines = [f"{self.folder}: {count} thing{'s' if count > 1 else ''} to correct"]
            told = grouped(self.violations)
            lines += [f"  - {line}" for line in told[:_LISTED]]
            if len(told) > _LISTED:
                lines.append(f"  ... and {len(told) - _LISTED} more")
            return "\n".join(lines)
        width = max(map(len, self.facts))
        doubts = sum(finding.severity == "doubt" for finding in self.geometry)
        doubtful = f"; its geometry is doubtful in {doubts} place{'s' if doubts > 1 else ''}"
        lines = [f"{self.folder}: a valid recording{doubtful if doubts else ''}"]
        lines += [f"  {name:<{width}}  {fact}" for name, fact in self.facts.items()]
        words = {"doubt": "doubtful", "note": "note"}
        lines += [f"  {words[finding.severity]}: {finding.text}" for finding in self.geometry]
        lines += [f"  note: {note}" for note in self.notes]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, object]:
        """Return the inspection for a program, as JSON-compatible values."""
        return {
            "path": str(self.folder),
            "kind": "recording",
            "ok": self.ok,
            "problems": grouped(self.violations),
            "folder": str(self.folder),
            "valid": self.valid,
            "facts": dict(self.facts),
            "notes": list(self.notes),
            "violations": [asdict(violation) for violation in self.violations],
            "geometry": [asdict(finding) for finding in self.geometry],
        }


def inspect(folder: Recording | Path | str) -> Inspection:
    """Inspect a recording: decode every picture, and compare the stated geometry with them.

    Args:
        folder: folder with a recording.json; or a `Recording`, read or made of arrays.
    """
    if isinstance(folder, Recording):
        recording, folder = folder, folder.folder
    else:
        folder = Path(folder)
        checked = check_recording(folder, thorough=True)
        recording = checked.recording
        if recording is None:
            return Inspection(folder, {}, (), checked.violations)
    geometry = check_geometry(recording)
    return Inspection(folder, _facts(recording), _notes(recording), (), geometry)


def _facts(recording: Recording) -> dict[str, str]:
    frames = recording.frames
    facts = {
        "frames": f"{len(frames)}, from {frames[0].time_s:g} to {frames[-1].time_s:g} s",
        "shown by": _kinds(recording),
    }
    for camera in recording.cameras:
        pose = " ".join(f"{value:.3f}" for value in camera.position)
        size = f"{camera.width} x {camera.height}, fx {camera.fx:.1f}, at ({pose}) m"
        facts[f"camera {camera.name}"] = size
        first = next((frame for frame in frames if camera.name in frame.depth), None)
        if first is not None:
            unit_m = recording.depth_units_m[camera.name]
            facts[f"depth {camera.name}"] = _depth(read_depth(first.depth[camera.name], unit_m))
    facts["table"] = _table(recording)
    facts["actions"] = _actions(recording)
    for name, path in recording.picker_paths.items():
        span = f"{len(path.time_s)} samples, {path.time_s[0]:g} to {path.time_s[-1]:g} s"
        facts[f"picker {name}"] = f"{span}, closed in {100 * path.closed.mean():.0f} %"
    return facts | {"cloth": _cloth(recording)}


def _kinds(recording: Recording) -> str:
    counts = {
        "color": sum(bool(frame.color) for frame in recording.frames),
        "depth": sum(bool(frame.depth) for frame in recording.frames),
        "masks": sum(bool(frame.mask) for frame in recording.frames),
        "clouds": sum(frame.cloud is not None for frame in recording.frames),
    }
    total = len(recording.frames)
    return ", ".join(
        kind if count == total else f"{kind} ({count} of {total} frames)"
        for kind, count in counts.items()
        if count
    )


def _depth(depth: Float[np.ndarray, "height width"]) -> str:
    measured = depth[depth > 0]
    low, middle, high = np.percentile(measured, [1, 50, 99]).tolist()
    share = 100 * measured.size / depth.size
    return f"{low:.3f} to {high:.3f} m, median {middle:.3f} m, {share:.0f} % of the pixels"


def _table(recording: Recording) -> str:
    if recording.table is None:
        if recording.cloth.template is not None:
            return "none: the cloth hangs"
        return f"not known yet: {_table_finder(recording)} finds it, if the cloth lies on one"
    point, normal = recording.table.point, recording.table.normal
    tilt = np.degrees(np.arccos(np.clip(normal[2], -1, 1)))
    return f"through ({point[0]:.3f} {point[1]:.3f} {point[2]:.3f}) m, tilted {tilt:.1f} degrees"


def _table_finder(recording: Recording) -> str:
    """Return the command that finds the table; it keeps a world in which a path is given."""
    posed = any((camera.world_from_camera != np.eye(4)).any() for camera in recording.cameras)
    keep = " --keep-world" if posed and recording.picker_paths else ""
    return f"clothtrack calibrate-camera{keep}"


def _actions(recording: Recording) -> str:
    if not recording.actions:
        return "none"
    spans = [
        f"{a.first_frame}-{a.last_frame} by {' + '.join(a.pickers)}" for a in recording.actions
    ]
    return f"{len(spans)}: {_joined(spans, 4)}"


def _cloth(recording: Recording) -> str:
    cloth = recording.cloth
    parts = [cloth.kind]
    if cloth.color:
        parts.append(cloth.color)
    if cloth.size_m:
        parts.append(f"{cloth.size_m[0]:g} x {cloth.size_m[1]:g} m")
    if cloth.template is not None:
        parts.append(f"template of {cloth.template.vertex_count} vertices")
    if cloth.held_vertices:
        parts.append(f"held by {', '.join(cloth.held_vertices)}")
    return ", ".join(parts)


def _notes(recording: Recording) -> tuple[str, ...]:
    """Return what is worth knowing."""
    notes = []
    if not recording.actions:
        notes.append("no actions: there is nothing that moves the cloth in the simulation")
    if recording.cloth.template is None:
        notes.append(f"no template (cloth.template): {_without_template(recording)}")
    try:
        observation = observe(recording, recording.frames[0])
    except ClothTrackError as error:
        notes.append(f"the cloth is not found in frame 0: {error}")
    else:
        extent = np.ptp(observation.points, axis=0)
        notes.append(
            f"frame 0 shows {len(observation.points)} points of cloth at 4 mm, "
            f"{extent[0]:.2f} x {extent[1]:.2f} x {extent[2]:.2f} m along x, y, z"
        )
        if reaches_rim(observation):
            notes.append(
                "the cloth reaches the rim of the picture in frame 0, and tracking needs all of it "
                "in the picture: move the camera or the cloth"
            )
    return tuple(notes)


def _without_template(recording: Recording) -> str:
    """Return what follows from the missing template, and what else is missing."""
    kind = recording.cloth.kind
    if kind not in ("towel", "tshirt"):
        text = "only a towel or a T-shirt on a table is tracked without one"
        return f"{text}, and cloth.kind is {kind!r}"
    if recording.table is None:
        return (
            f"a {kind} is tracked without one when its table is known; find the table with: "
            f"{_table_finder(recording)}"
        )
    return (
        "tracking starts from a flat garment fitted to the first cloud, or from the reconstruction "
        "network where the cloth does not lie flat"
    )


def _joined(words: Sequence[str], most: int) -> str:
    more = f", and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(words[:most]) + more
