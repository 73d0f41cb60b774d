"""Numbers of a tracked trajectory that a report shows, computed from what was observed."""

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.quality import edge_strain
from clothtrack.report.curves import Chart, Line
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


def edge_strains(tracked: TrackedTrajectory) -> Float[np.ndarray, " frames"]:
    """Mean absolute relative change of edge length against the first mesh, per frame."""
    return np.array([edge_strain(tracked.mesh, positions) for positions in tracked.positions])


def charts(tracked: TrackedTrajectory, rms_mm: Float[np.ndarray, " frames"]) -> tuple[Chart, ...]:
    """The charts of a report, the most telling first."""
    steps = tracked.steps
    gave_up = tuple(int(frame) for frame in tracked.frames[np.asarray(steps.gave_up, dtype=bool)])
    return (
        Chart(
            "Distance to the observed cloud",
            "mm",
            (Line("root mean square", rms_mm),),
            "Visible vertices and cloud, both directions, as clothtrack evaluate measures it.",
        ),
        Chart(
            "Edge strain",
            "%",
            (Line("mean over all edges", 100 * edge_strains(tracked)),),
            "Says more about hidden errors than the distance does.",
        ),
        Chart(
            "Alignment objective",
            "m²",
            (Line("predicted", steps.loss_before, 1), Line("aligned", steps.loss_after, 0)),
            "Before and after aligning the mesh with the cloud (TTO1).",
            logarithmic=True,
        ),
        Chart(
            "Visible share of the cloth",
            "%",
            (Line("vertices that some camera sees", 100 * tracked.visible.mean(axis=1)),),
            least_top=100.0,
        ),
        Chart(
            "Line search",
            "",
            (Line("roll-outs tried", np.asarray(steps.trials, dtype=np.float64), 0),),
            "How often a correction had to be shortened until the dynamics took it.",
            marks=gave_up,
            marks_label="correction dropped",
        ),
        Chart(
            "Highest speed",
            "m/s",
            (Line("fastest vertex of the accepted roll-out", steps.highest_speed),),
        ),
        Chart(
            "Computing time",
            "s of CPU per frame",
            (
                Line("predict", steps.predict_s, 0),
                Line("align", steps.align_s, 1),
                Line("correct", steps.correct_s, 2),
            ),
            "With the parameters that were kept; the search for them is not drawn.",
        ),
    )
