"""Numbers of a tracked trajectory that a report shows, computed from what was observed."""

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.quality import edge_strain
from clothtrack.report.curves import Chart, Line
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


def edge_strains(tracked: TrackedTrajectory) -> Float[np.ndarray, " frames"]:
    """Mean absolute relative change of edge length against the first mesh, per frame."""
    return np.array([edge_strain(tracked.mesh, positions) for positions in tracked.positions])


def charts(
    tracked: TrackedTrajectory,
    rms_mm: Float[np.ndarray, " frames"],
    floor_mm: Float[np.ndarray, " frames"],
) -> tuple[Chart, ...]:
    """The charts of a report, the most telling first."""
    steps = tracked.steps
    gave_up = tuple(int(frame) for frame in tracked.frames[np.asarray(steps.gave_up, dtype=bool)])
    return (
        Chart(
            "Distance to the observed cloud",
            "mm",
            (Line("root mean square", rms_mm, 0), Line("noise alone", floor_mm, 2)),
            "Visible mesh to observed points and back. Noise: what two halves of the cloud are "
            "apart, the least that a perfect mesh has.",
        ),
        Chart(
            "Edge strain",
            "%",
            (Line("mean over all edges", 100 * edge_strains(tracked)),),
            "Says more about hidden errors than the distance does.",
        ),
        Chart(
            "Alignment",
            "mm",
            (
                Line("predicted", _rms_mm(steps.loss_before), 1),
                Line("aligned", _rms_mm(steps.loss_after), 0),
            ),
            "How far the mesh is from the cloud as the physics predicts it, and after the camera "
            "has corrected it (root of half the objective of TTO1).",
        ),
        Chart(
            "Visible share of the cloth",
            "%",
            (Line("vertices that some camera sees", 100 * tracked.visible.mean(axis=1)),),
            "The rest of the mesh is the tracker's belief.",
            least_top=100.0,
        ),
        Chart(
            "Line search",
            "",
            (Line("roll-outs tried", np.asarray(steps.trials, dtype=np.float64), 0),),
            "1: the physics took the correction whole. More: it had to be shortened so often. 0: "
            "nothing was corrected, as where an action starts.",
            marks=gave_up,
            marks_label="correction dropped",
        ),
        Chart(
            "Highest speed",
            "m/s",
            (Line("fastest vertex of the accepted roll-out", steps.highest_speed),),
            "Peaks while nothing moves: the simulation is unstable.",
        ),
        _computing_time(tracked),
    )


def _computing_time(tracked: TrackedTrajectory) -> Chart:
    steps = tracked.steps
    return Chart(
        "Computing time",
        "s of CPU per frame",
        (
            Line("predict", steps.predict_s, 0),
            Line("align", steps.align_s, 1),
            Line("correct", steps.correct_s, 2),
        ),
        "With the parameters that were kept; the search for them is not drawn.",
    )


def _rms_mm(losses: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " frames"]:
    """Objectives [m^2] as distances [mm]."""
    return 1e3 * np.sqrt(0.5 * np.asarray(losses, np.float64))
