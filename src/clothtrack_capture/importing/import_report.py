"""The report of an import: what was found, left out, and is still missing for tracking."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from clothtrack.recordings.recording import PickAndPlace, PickerPath
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.registration import Registration
from clothtrack_capture.importing.source import Streams
from clothtrack_capture.importing.times import Pairing
from clothtrack_capture.importing.units import DepthUnit


@dataclass(frozen=True)
class ImportReport:
    """The report of `clothtrack import`: what was written, from what, and what is left to do."""

    recording: Path
    source: Path
    kind: str  # name of the source's format
    frames: int  # that were written
    duration_s: float  # from the first to the last frame
    frames_per_s: float  # mean over the whole duration
    camera: str  # description
    streams: Mapping[str, str]  # topic, track or folder that each item came from
    depth_unit_m: float  # meters per unit of stored depth
    depth_unit_origin: str
    registration: str  # whether depth had to be registered to the color camera
    tolerance_s: float  # largest allowed time difference between the pictures of a frame
    worst_apart_s: float  # largest time difference found
    dropped: Sequence[str]  # what was left out
    notes: Sequence[str]
    pickers: Mapping[str, int]  # number of path samples of each
    actions: Sequence[tuple[int, int]]  # first and last frame of each
    missing: Sequence[str]  # what tracking still needs, and how to get it
    next_command: str

    def text(self) -> str:
        """Return the report as text."""
        facts = {
            "source": f"{self.source} ({self.kind})",
            "frames": f"{self.frames} in {self.duration_s:.3f} s ({self.frames_per_s:.1f} per s)",
            "camera": self.camera,
            **dict(self.streams),
            "depth unit": f"{self.depth_unit_m:g} m ({self.depth_unit_origin})",
            "registration": self.registration,
        }
        if "color" in self.streams:
            tolerance = f"tolerance {1e3 * self.tolerance_s:.1f} ms"
            facts["pairing"] = f"at most {1e3 * self.worst_apart_s:.1f} ms apart ({tolerance})"
        if self.pickers:
            facts["picker path"] = ", ".join(f"{name}: {n}" for name, n in self.pickers.items())
            spans = ", ".join(f"{first}-{last}" for first, last in self.actions[:8])
            more = " ..." if len(self.actions) > 8 else ""
            facts["actions"] = f"{len(self.actions)}: frames {spans}{more}" if spans else "none"
        width = max(map(len, facts))
        lines = [f"{self.recording}: imported"]
        lines += [f"  {name:<{width}}  {value}" for name, value in facts.items()]
        lines += [f"  left out: {text}" for text in self.dropped]
        lines += [f"  note: {text}" for text in self.notes]
        lines += [f"  missing for tracking: {text}" for text in self.missing]
        return "\n".join([*lines, f"  next: {self.next_command}"])

    def as_dict(self) -> dict[str, object]:
        """Return the report as JSON content."""
        return {**asdict(self), "recording": str(self.recording), "source": str(self.source)}


@dataclass(frozen=True, eq=False)
class Imported:
    """What an import made of a source; times in seconds."""

    streams: Streams
    pairing: Pairing
    registration: Registration
    unit: DepthUnit
    times: Sequence[float]
    damaged: Counter[str]
    masks: int
    paths: Mapping[str, PickerPath]
    actions: Sequence[PickAndPlace]
    notes: Sequence[str]
    posed: bool
    table: bool


def report_of(source: Path, folder: Path, done: Imported, options: ImportOptions) -> ImportReport:
    """Return the report of an import."""
    duration, lens = done.times[-1] - done.times[0], done.registration.intrinsics
    # With a picker path, a calibration must not change the recording's world.
    aside = " --output camera.json" if done.paths else ""
    following = f"clothtrack calibrate-camera {folder}{aside}"
    if done.table:
        following = f"clothtrack inspect {folder}"
    elif done.posed:
        following = f"clothtrack calibrate-camera {folder} --keep-world"
    return ImportReport(
        recording=folder,
        source=source,
        kind=done.streams.kind,
        frames=len(done.times),
        duration_s=duration,
        frames_per_s=(len(done.times) - 1) / duration if duration > 0 else 0.0,
        camera=f"camera, {lens.width} x {lens.height}, fx {lens.fx:.1f}"
        + ("" if done.posed else ", pose not known: its frame stands in for the world"),
        streams=done.streams.origins,
        depth_unit_m=done.unit.stored_m,
        depth_unit_origin=done.unit.origin + ", stored in 0.1 mm" * done.unit.is_float,
        registration=_registration(done),
        tolerance_s=done.pairing.tolerance_s,
        worst_apart_s=done.pairing.worst_s,
        dropped=_dropped(done.pairing, done.damaged),
        notes=[*done.streams.notes, *done.notes],
        pickers={name: len(path.time_s) for name, path in done.paths.items()},
        actions=[(action.first_frame, action.last_frame) for action in done.actions],
        missing=_missing(folder, done, options, aside),
        next_command=following,
    )


def _registration(done: Imported) -> str:
    calibration = done.streams.calibration
    if done.registration.carried:
        return "depth carried to the color camera, nearest wins, uncovered pixels 0"
    if not calibration.depth.straight:
        return "none needed; distortion taken out"
    return "none needed" if calibration.color is not None else "none needed: no color"


def _dropped(pairing: Pairing, damaged: Counter[str]) -> list[str]:
    advice = f" ({pairing.advice})" if pairing.advice else ""
    counts = {
        f"depth pictures without color near enough in time{advice}": pairing.depth_alone,
        "color pictures without depth near enough in time": pairing.color_alone,
        "depth pictures with the time stamp of another; --stamps written takes the times of "
        "writing where the source has them": pairing.doubles,
    }
    counts |= {f"frames: {reason}": count for reason, count in damaged.most_common(5)}
    counts["more frames that cannot be decoded"] = sum(n for _, n in damaged.most_common()[5:])
    return [f"{count} {what}" for what, count in counts.items() if count]


def _missing(folder: Path, done: Imported, options: ImportOptions, aside: str) -> list[str]:
    missing = []
    if not done.posed:
        again = "; then import again with --world-from-camera camera.json, for one world"
        missing.append(
            "the table and the camera's pose (world_from_camera): clothtrack calibrate-camera "
            f"{folder}{aside} finds both{again if done.paths else ''}"
        )
    elif not done.table:
        missing.append(f"the table: clothtrack calibrate-camera {folder} --keep-world finds it")
    if not done.paths:
        missing.append(
            f"the picker's path: clothtrack find-picker {folder} finds a colored tip (--tip-color "
            "NAME) or a bare hand (--by-hand); or write picker.csv (docs/data_format.md), or "
            "import again with --picker-csv, --picker-topic or --picker-frame"
        )
    elif not done.actions:
        gripper = "" if options.gripper_topic else "--gripper-topic, a column `closed`, or "
        missing.append(
            f"actions: the path never closes; import again with {gripper}--actions FIRST-LAST"
        )
    if options.cloth == "other":
        missing.append(
            "the cloth's kind: --cloth towel or tshirt, or cloth.kind in recording.json; any other "
            "garment needs a template (clothtrack garment)"
        )
    elif options.cloth == "trousers":
        missing.append("a template: trousers are tracked from one (clothtrack garment)")
    if done.streams.color is not None and options.cloth_color is None and not done.masks:
        missing.append(
            f"which pixels are cloth: clothtrack segment {folder} by a click, or its color by "
            "--cloth-color NAME, or cloth.color in recording.json"
        )
    return missing
