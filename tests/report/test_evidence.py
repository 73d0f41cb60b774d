from dataclasses import replace

import numpy as np
import pytest

from clothtrack.evaluation.metrics import chamfer_pc, root_mean_square_mm
from clothtrack.evaluation.results import evaluate
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording
from clothtrack.report.evidence import (
    evidence_of,
    observed_points,
    view_picture,
)
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

NOTHING = np.empty((0, 3))


def test_a_frame_that_cannot_be_read_costs_the_picture_only(two_cameras, tmp_path, caplog):
    camera = two_cameras.cameras[0]
    missing = {camera.name: tmp_path / "gone.png"}
    frame = replace(two_cameras.frames[0], color=missing, depth=missing, mask={})
    assert view_picture(two_cameras, frame, camera, NOTHING).shape == (120, 160, 3)
    assert len(observed_points(two_cameras, frame)) == 0
    assert caplog.text.count("gone.png") == 2


@pytest.fixture
def observe_as(monkeypatch):
    """Have these clouds observed, and every pixel of the recording's cameras seen."""

    def replaced(clouds, recording):
        remaining = iter(clouds)

        def observed(_, frame):
            return Observation(next(remaining), recording.cameras, {}, None, np.empty((0, 3)), 0.0)

        monkeypatch.setattr("clothtrack.report.evidence.observe", observed)

    return replaced


def test_a_cloud_beside_the_cloth_is_as_far_as_it_was_moved(tracked, two_cameras, observe_as):
    still = replace(tracked, positions=np.repeat(tracked.mesh.vertices[None], 6, axis=0),
                    visible=np.ones_like(tracked.visible))  # fmt: skip
    clouds = [tracked.mesh.vertices + np.array([0.0, 0.0, 0.003])] * 6
    observe_as(clouds, two_cameras)
    evidence = evidence_of(still, two_cameras)
    np.testing.assert_allclose(evidence.rms_mm, 3.0, rtol=1e-6)


def test_the_chart_and_the_table_of_evaluate_show_the_same_number():
    """On the shipped recording, where the tool hides some of the cloth."""
    recording = read_recording(shipped_recording("fold_the_tshirt"))
    mesh, last = recording.cloth.template, recording.actions[-1].last_frame
    points = observe(recording, recording.frames[last]).points
    lift = points.mean(axis=0) - mesh.vertices.mean(axis=0)
    vertices = (mesh.vertices + lift).astype(np.float32)
    seen = VisibilityCheck(mesh.faces, recording.cameras)(vertices)
    blank = Calibration("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)
    placed = TrackedTrajectory(
        name=recording.name,
        mesh=mesh,
        frames=np.array([last]),
        time_s=np.array([recording.frames[last].time_s]),
        positions=vertices[None],
        visible=seen[None],
        actions=(TrackedAction(0, last, vertices, vertices, np.zeros(2), {}, blank, {}),),
        steps=StepRecords.empty(1),
    )
    row = evaluate(placed, recording).rows[-1]
    (shown,) = evidence_of(placed, recording).rms_mm
    np.testing.assert_allclose(shown, row.chamfer_pc_rms_mm, rtol=1e-6)
    everything = root_mean_square_mm(chamfer_pc(vertices.astype(float), seen, points))
    assert (
        abs(shown - everything) > 0.01
    )  # leaving unobservable vertices out makes a difference here
