"""A tracked trajectory as pictures that others look at: contact sheet, video, Rerun recording."""

from pathlib import Path
from typing import Literal

from clothtrack.evaluation.truth import Truth
from clothtrack.recordings.recording import Recording
from clothtrack.report.coloring import colorings
from clothtrack.report.evidence import evidence_of
from clothtrack.report.measures import charts
from clothtrack.report.overlay import (
    Overlay,
    OverlayConfig,
    write_contact_sheet,
    write_overlay_video,
)
from clothtrack.report.rerun_file import write_rerun
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

PictureFormat = Literal["sheet", "mp4", "rrd"]
SUFFIXES = {"sheet": ".png", "mp4": ".mp4", "rrd": ".rrd"}


def export_pictures(
    tracked: TrackedTrajectory,
    recording: Recording,
    out: Path,
    kind: PictureFormat,
    *,
    rows: int = 6,
    truth: Truth | None = None,
) -> Path:
    """Write a trajectory over its recording and return where it is; the suffix is added if missing.

    Args:
        tracked: what the tracker left.
        recording: what it was tracked from.
        out: file to write.
        kind: `sheet`: a PNG with `rows` frames, each observed, tracked over it, and the mesh alone;
            `mp4`: the tracked mesh over the observation; `rrd`: everything, for Rerun's viewer.
        rows: frames on the sheet.
        truth: the true meshes; adds the error to an rrd.

    Raises:
        InvalidConfigError: rrd without the extra [rerun].
        InvalidResultError: the truth is of another garment or another recording.
        StorageError: when the disk refuses.
    """
    suffix = SUFFIXES[kind]
    out = out if out.suffix == suffix else Path(f"{out}{suffix}")
    if kind == "rrd":
        evidence = evidence_of(tracked, recording)
        return write_rerun(
            tracked,
            recording,
            out,
            clouds=evidence.clouds,
            colorings=colorings(tracked, evidence.clouds, truth=truth),
            charts=charts(tracked, evidence.rms_mm, evidence.floor_mm),
        )
    overlay = Overlay(tracked, recording, config=OverlayConfig())
    if kind == "sheet":
        return write_contact_sheet(overlay, out, rows=rows)
    write_overlay_video(overlay, out)
    return out
