"""One trajectory in a line of an index: a small picture, its verdict, the error to expect."""

from dataclasses import dataclass

import cv2
import numpy as np

from clothtrack.evaluation.metrics import root_mean_square_mm
from clothtrack.evaluation.results import observed_chamfer
from clothtrack.evaluation.verdict import Verdict, verdict_of
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.report.coloring import judged_or_none
from clothtrack.report.evidence import Observer, observed
from clothtrack.report.overlay import Overlay, OverlayConfig
from clothtrack.report.sections import jpeg_uri
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

THUMBNAIL_PX = 120
"""Height of the picture [pixels]."""


@dataclass(frozen=True)
class TrajectorySummary:
    """What an index says about one trajectory.

    Attributes:
        thumbnail: the mesh over the picture at the last label, as a data address.
        verdict: of its worst label.
        expected_error_mm: largest expected error of its labels [mm]; NaN where nobody knows.
        quality: smallest quality of its labels, 0 to 1; NaN where nobody knows.
        rms_mm: distance of visible mesh and observed points at the last label [mm]; NaN without.
    """

    thumbnail: str
    verdict: Verdict
    expected_error_mm: float
    quality: float
    rms_mm: float


def summary_of(
    tracked: TrackedTrajectory, recording: Recording, observer: Observer = observed
) -> TrajectorySummary:
    """Look at the last label of a trajectory, and judge all of them."""
    last = tracked.actions[-1].last_frame if tracked.actions else int(tracked.frames[-1])
    step = int(np.abs(tracked.frames - last).argmin())
    config = OverlayConfig(height=2 * THUMBNAIL_PX, cameras=1)
    picture = Overlay(tracked, recording, config=config, observer=observer).draw(step)
    width = round(picture.shape[1] * THUMBNAIL_PX / picture.shape[0])
    small = cv2.resize(picture, (width, THUMBNAIL_PX), interpolation=cv2.INTER_AREA)
    judged = judged_or_none(tracked, recording)
    verdict = verdict_of(tracked, recording, judged)
    return TrajectorySummary(
        jpeg_uri(small, quality=80),
        verdict,
        1e3 * verdict.expected_error_m,
        min((label.label_quality for label in judged), default=float("nan")),
        _rms_mm(tracked, recording, step, observer),
    )


def _rms_mm(
    tracked: TrackedTrajectory, recording: Recording, step: int, observer: Observer
) -> float:
    frames = {frame.index: frame for frame in recording.frames}
    index, time_s = int(tracked.frames[step]), float(tracked.time_s[step])
    observation = observer(recording, frames.get(index) or Frame(index, time_s))
    if observation is None:
        return float("nan")
    vertices = tracked.positions[step].astype(np.float64)
    return root_mean_square_mm(observed_chamfer(vertices, tracked.visible[step], observation))
