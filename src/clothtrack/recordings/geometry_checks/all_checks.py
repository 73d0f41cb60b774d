"""All checks of the geometry, in the order in which one finding explains the next."""

from dataclasses import replace

import numpy as np

from clothtrack.recordings.geometry_checks.action_checks import action_findings
from clothtrack.recordings.geometry_checks.camera_checks import camera_findings
from clothtrack.recordings.geometry_checks.camera_motion import camera_motion_findings
from clothtrack.recordings.geometry_checks.clock_checks import time_findings
from clothtrack.recordings.geometry_checks.cloth_checks import cloth_findings
from clothtrack.recordings.geometry_checks.color_checks import registration
from clothtrack.recordings.geometry_checks.finding import Finding, ObservedFrames
from clothtrack.recordings.geometry_checks.lens_checks import lens_findings
from clothtrack.recordings.geometry_checks.mask_checks import mask_findings
from clothtrack.recordings.geometry_checks.picker_checks import picker_findings
from clothtrack.recordings.geometry_checks.picker_clock import clock_findings
from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures
from clothtrack.recordings.geometry_checks.stream_checks import stream_findings
from clothtrack.recordings.geometry_checks.template_checks import size_findings, template_findings
from clothtrack.recordings.geometry_checks.tip_checks import hand_findings, motion_findings
from clothtrack.recordings.recording import Recording


def check_geometry(
    recording: Recording, frames: ObservedFrames | None = None
) -> tuple[Finding, ...]:
    """Return where the pictures of a recording contradict it; empty for a right one.

    One error causes others: a wrong world makes everything in it wrong. If a camera is doubted,
    cloth and picker are not checked; if a picker's clock is doubted, its path is not checked.
    """
    frames = frames or ObservedFrames(recording)
    alone = sense_findings(recording, frames.small)
    cameras = camera_findings(recording)
    if cameras:
        return (*cameras, *alone)
    cloth = cloth_findings(recording, frames)
    if any(finding.kind in ("depth_unit", "scale", "cloth_height") for finding in cloth):
        return (*cloth, *alone)
    if any(finding.kind == "clock_unit" for finding in alone):
        return (*alone, *cloth)
    clock = clock_findings(recording, frames)
    path = clock or picker_findings(recording, frames)
    return (*alone, *cloth, *(path or _carrying(recording, frames)))


def _carrying(recording: Recording, frames: ObservedFrames) -> list[Finding]:
    """Return what is wrong with a path that leads through the cloth."""
    moved = [] if frames.small is None else motion_findings(recording, frames.small)
    return [*action_findings(recording), *(moved or hand_findings(recording, frames))]


def sense_findings(recording: Recording, pictures: SmallPictures | None) -> list[Finding]:
    """Return implausible values, and where color, depth and masks contradict each other."""
    alone = [
        *time_findings(recording), *size_findings(recording), *template_findings(recording),
        *lens_findings(recording),
    ]  # fmt: skip
    if pictures is None:
        return alone
    stream = stream_findings(recording, pictures)
    color = registration(pictures)
    if color is not None and color.finding is not None:
        in_step = registration(_in_step(pictures, stream))
        if in_step is not None and in_step.finding is None and in_step.fit >= color.fit:
            color = in_step  # A late stream shows things at other places.
        elif in_step is not None:
            stream = [finding for finding in stream if finding.kind != "stream_delay"]
    placed = [] if color is None or color.finding is None else [color.finding]
    pushed = camera_motion_findings(recording, pictures)
    return [*alone, *pushed, *stream, *placed, *mask_findings(recording, pictures)]


def _in_step(pictures: SmallPictures, findings: list[Finding]) -> SmallPictures:
    """Return the pictures with the delay of one stream removed."""
    delays = [each for each in findings if each.kind == "stream_delay"]
    if not delays or pictures.color is None:
        return pictures
    (delay,) = delays
    count = len(pictures.frames) - int(delay.measured)
    later, earlier = np.arange(int(delay.measured), len(pictures.frames)), np.arange(count)
    color, height = (later, earlier) if delay.field.endswith("color") else (earlier, later)
    return replace(
        pictures,
        frames=pictures.frames[:count],
        color=pictures.color[color],
        height_m=pictures.height_m[height],
        mask=None,
        same_color=pictures.same_color[color],
        same_depth=pictures.same_depth[height],
    )
