"""What an import found, what it left out and what is still missing before tracking."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True)
class ImportReport:
    """The answer of `clothtrack import`.

    Attributes:
        recording: folder that was written.
        source: what was read.
        kind: its format in words.
        frames: how many frames were written.
        duration_s: time from the first to the last frame [s].
        frames_per_s: frames per second, over the whole duration [1/s].
        camera: the recording's camera, in words.
        streams: which topic, track or folder each thing came from.
        depth_unit_m: metres per unit of depth.
        depth_unit_origin: where the unit comes from.
        registration: whether depth had to be carried to the colour camera.
        tolerance_s: how far apart the pictures of a frame may be [s].
        worst_apart_s: how far apart they are at most [s].
        dropped: what was left out, in words.
        notes: what else to know.
        pickers: samples of the path per picker.
        actions: first and last frame of every action.
        missing: what tracking still needs, and how to get it.
        next_command: what to run next.
    """

    recording: Path
    source: Path
    kind: str
    frames: int
    duration_s: float
    frames_per_s: float
    camera: str
    streams: Mapping[str, str]
    depth_unit_m: float
    depth_unit_origin: str
    registration: str
    tolerance_s: float
    worst_apart_s: float
    dropped: Sequence[str]
    notes: Sequence[str]
    pickers: Mapping[str, int]
    actions: Sequence[tuple[int, int]]
    missing: Sequence[str]
    next_command: str

    def text(self) -> str:
        """Return the report for a person."""
        facts = {
            "source": f"{self.source} ({self.kind})",
            "frames": f"{self.frames} in {self.duration_s:.3f} s ({self.frames_per_s:.1f} per s)",
            "camera": self.camera,
            **dict(self.streams),
            "depth unit": f"{self.depth_unit_m:g} m ({self.depth_unit_origin})",
            "registration": self.registration,
        }
        if "colour" in self.streams:
            facts["pairing"] = (
                f"at most {1e3 * self.worst_apart_s:.1f} ms apart "
                f"(tolerance {1e3 * self.tolerance_s:.1f} ms)"
            )
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
        """Return the report for a program, as JSON holds it."""
        content: dict[str, object] = asdict(self)
        content |= {"recording": str(self.recording), "source": str(self.source)}
        return content
