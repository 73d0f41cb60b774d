"""Colorings of a cloth per vertex: distance to the cloud, expected and true error.

Only `truth_errors` uses the truth, and its title says so.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from clothtrack.errors import ClothTrackError, InvalidResultError
from clothtrack.evaluation.label_quality import LabelQuality, expected_vertex_errors, judge_labels
from clothtrack.evaluation.naming import true_places
from clothtrack.evaluation.truth import Truth, material_points
from clothtrack.recordings.recording import Recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

log = logging.getLogger(__name__)

_FARTHEST_CLOUD_MM = 20.0
"""Top of the scale of distances to the cloud [mm]."""


@dataclass(frozen=True, eq=False)
class Coloring:
    """Value of every vertex at every frame, shown as a color.

    Attributes:
        title: name of the value, with its unit.
        values: values from 0 upwards; NaN if unknown.
    """

    key: str
    title: str
    note: str
    limit: float
    values: Float[np.ndarray, "frames vertices"]


def colorings(
    tracked: TrackedTrajectory,
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    judged: Sequence[LabelQuality] = (),
    truth: Truth | None = None,
) -> tuple[Coloring, ...]:
    """Return all colorings of a trajectory, other than sides and visibility.

    Args:
        clouds: observed points of each frame [m].
    """
    colorings = [cloud_gaps(tracked, clouds)]
    if judged:
        colorings.append(expected_errors(tracked, judged))
    if truth is not None:
        colorings.append(truth_errors(tracked, truth))
    return tuple(colorings)


def judged_or_none(tracked: TrackedTrajectory, recording: Recording) -> tuple[LabelQuality, ...]:
    """Return the qualities of the labels; empty, with a warning, if this fails."""
    try:
        return judge_labels(tracked, recording)
    except ClothTrackError as error:
        log.warning("%s: labels are not judged (%s)", tracked.name, error)
        return ()


def cloud_gaps(tracked: TrackedTrajectory, clouds: Sequence[Float[np.ndarray, "_ 3"]]) -> Coloring:
    """Return the distance [mm] of each visible vertex to the nearest observed point."""
    values = np.full(tracked.visible.shape, np.nan, np.float32)
    for step, points in enumerate(clouds):
        seen = tracked.visible[step]
        if len(points) and seen.any():
            values[step, seen] = 1e3 * cKDTree(points).query(tracked.positions[step][seen])[0]
    return Coloring(
        "cloud",
        "Distance to what was observed [mm]",
        "Small says little about hidden layers; gray vertices were not seen.",
        min(_graded_limit(values), _FARTHEST_CLOUD_MM),
        values,
    )


def expected_errors(tracked: TrackedTrajectory, judged: Sequence[LabelQuality]) -> Coloring:
    """Return each vertex's expected error [mm] at the end of an action, for all its frames."""
    values = np.full(tracked.visible.shape, np.nan, np.float32)
    for action, label in zip(tracked.actions, judged, strict=True):
        inside = (tracked.frames >= action.first_frame) & (tracked.frames <= action.last_frame)
        values[inside] = 1e3 * expected_vertex_errors(action, label)
    return Coloring(
        "label",
        "Expected error at the end of the action [mm]",
        "Estimated without the truth: on the whole from what was observed, vertex by vertex from "
        "where the tracked candidates disagree.",
        _graded_limit(values),
        values,
    )


def vertex_errors(expected_error_m: Float[np.ndarray, " vertices"]) -> Coloring:
    """Return the error [mm] that a network predicts for each vertex of one mesh."""
    values = 1e3 * expected_error_m[None]
    title, note = "Expected error [mm]", "As the network says it, vertex by vertex."
    return Coloring("expected", title, note, _graded_limit(values), values)


def _true_positions(
    tracked: TrackedTrajectory, truth: Truth
) -> Float[np.ndarray, "frames vertices 3"]:
    """Return the true position of each vertex [m]; NaN at frames without truth."""
    where = true_places(tracked, truth)
    if where is None:
        raise InvalidResultError(
            f"{tracked.name}: the truth or the mesh has no canonical coordinates, so that nobody "
            "knows which vertex belongs where; leave the truth out"
        )
    positions = np.full(tracked.positions.shape, np.nan)
    for step, frame in enumerate(tracked.frames.tolist()):
        surface = truth.at(frame)
        if surface is not None:
            positions[step] = material_points(surface, truth.faces, where)
    return positions


def truth_errors(tracked: TrackedTrajectory, truth: Truth) -> Coloring:
    """Return the distance [mm] of each vertex to the true position of its material point."""
    points = _true_positions(tracked, truth)
    values = 1e3 * np.linalg.norm(tracked.positions - points, axis=2).astype(np.float32)
    if not np.isfinite(values).any():
        raise InvalidResultError(
            f"{tracked.name}: the truth knows none of its frames; give the truth of this recording"
        )
    return Coloring(
        "truth",
        "Error against the truth [mm]",
        "The truth is of a simulated world; the tracker never saw it.",
        _graded_limit(values),
        values,
    )


def _graded_limit(values: Float[np.ndarray, "frames vertices"]) -> float:
    """Return a round number not below 95 % of the values, at least 2."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 2.0
    high = max(2.0, float(np.percentile(finite, 95)))
    power = 10.0 ** np.floor(np.log10(high))
    return float(power * next(step for step in (1, 2, 5, 10) if step * power >= high))
