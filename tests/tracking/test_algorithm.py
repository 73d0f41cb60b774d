"""Algorithm 1 with parts of a few lines: what it asks of each, and in which order."""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest

from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.simulation.dynamics import PickerAction
from clothtrack.tracking.algorithm import track
from clothtrack.tracking.calibrator import uncalibrated
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.ensemble import chosen_candidate
from clothtrack.tracking.final_alignment import no_final_alignment
from clothtrack.tracking.picture_marks import no_marks
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.seams import Corrected, Correction, Parts, exact
from clothtrack.tracking.tracked_trajectory import Calibration
from clothtrack.tracking.tracker import Tracker
from clothtrack.tracking.visible_alignment import no_alignment


@dataclass(frozen=True)
class Cloth:
    """State and prediction of a cloth that drifts along x, as fast as theta says [m per frame]."""

    positions: np.ndarray
    started_at: np.ndarray | None = None
    highest_speed: np.ndarray = field(default_factory=lambda: np.zeros(1))

    @property
    def state(self):
        return self


class Nothing:
    """Grasps of nothing."""

    held_vertices: dict = {}  # noqa: RUF012

    def action(self, start_s, end_s):
        return PickerAction(None, end_s - start_s)

    def closed_at(self, time_s):
        return False

    def identity(self, theta):
        return tuple(theta.values())


def drifting(theta):
    def dyn(state, action, pseudo_action=None):
        return Cloth(state.positions + [theta["drift_m"], 0, 0], state.positions)

    return dyn


def to_the_origin(predicted, observation):
    start = predicted.positions[0]
    return Correction(start, -start, np.ones(len(start), bool), (1.0, 0.0))


def half(dyn, state, action, predicted, correction):
    if correction is None:
        return Corrected(predicted)
    return Corrected(Cloth((correction.start + 0.5 * correction.displacement)[None]), 0.5, 2)


@pytest.fixture
def parts(recording):
    return Parts(
        observe=partial(observe, recording),
        pick=lambda action, state, theta: Nothing(),
        calibrate=uncalibrated,
        dynamics=drifting,
        predict=exact,
        align=to_the_origin,
        line_search=half,
        combine=chosen_candidate,
        align_last=no_final_alignment,
        mark=no_marks,
    )


def tracked(recording: Recording, parts: Parts, theta=None, watch=None):
    mesh = recording.cloth.template
    start = Cloth(np.zeros((1, len(mesh.vertices), 3)))
    recorder = Recorder(recording, mesh, start, lambda each: np.ones(len(each), bool), watch=watch)
    track(recording, start, theta or {"drift_m": 1.0}, parts, recorder)
    return recorder.trajectory()


def test_every_frame_is_predicted_then_corrected(recording, parts):
    """x_{t+1} = (x_t + 1) / 2: the drift of a frame and half of the way back."""
    (action,) = recording.actions
    result = tracked(recording, parts)
    at = np.arange(len(recording.frames))
    expected = 1.0 - 0.5 ** np.clip(at - action.first_frame, 0, action.last_frame)
    np.testing.assert_allclose(result.positions[:, 0, 0], expected, rtol=1e-6)
    within = slice(action.first_frame + 1, action.last_frame + 1)
    assert (result.steps.correction_scale[within] == 0.5).all()
    assert np.isfinite(result.steps.predict_s[within]).all()
    assert np.isnan(result.steps.loss_after[action.first_frame])


def test_who_watches_is_shown_every_mesh_as_it_is_found(recording, parts):
    shown = []

    def watch(recording, mesh, frame, positions):
        assert mesh is recording.cloth.template
        shown.append((frame.index, positions[0, 0]))

    (action,) = recording.actions
    result = tracked(recording, parts, watch=watch)
    within = range(action.first_frame + 1, action.last_frame + 1)
    assert [frame for frame, _ in shown] == [0, *within, action.last_frame]
    found = [result.positions[frame, 0, 0] for frame, _ in shown]
    np.testing.assert_array_equal([place for _, place in shown], found)


def test_without_a_correction_the_dynamics_go_on_alone(recording, parts):
    result = tracked(recording, replace(parts, align=no_alignment))
    (action,) = recording.actions
    steps = action.last_frame - action.first_frame
    np.testing.assert_allclose(result.positions[-1, :, 0], steps)
    assert not result.steps.trials.any()


def test_the_final_alignment_is_what_the_next_action_starts_from(recording, parts):
    lifted = replace(
        parts,
        align_last=lambda state, theta, cloud, held: (
            Cloth(state.positions + [0, 0, 7]),
            (2.0, 1.0),
        ),
    )
    (action,) = tracked(recording, lifted).actions
    assert (action.positions_before_final_alignment[:, 2] == 0.0).all()
    assert (action.positions_after_final_alignment[:, 2] == 7.0).all()
    assert tuple(action.final_alignment_losses) == (2.0, 1.0)


def test_a_candidate_is_followed_once_and_the_others_leave_nothing(recording, parts):
    passes = []

    def dynamics(theta):
        passes.append(theta["drift_m"])
        return drifting(theta)

    def smallest(action, state, theta, follow_with):
        ends = {drift: follow_with({"drift_m": drift}) for drift in (3.0, 2.0, 5.0, 2.0)}
        best = min(ends, key=lambda drift: ends[drift].positions[-1].max())
        return {"drift_m": best}, Calibration.none()

    result = tracked(recording, replace(parts, dynamics=dynamics, calibrate=smallest))
    assert passes == [3.0, 2.0, 5.0]
    assert result.actions[0].parameters == {"drift_m": 2.0}
    alone = tracked(recording, parts, {"drift_m": 2.0})
    np.testing.assert_array_equal(result.positions, alone.positions)


def test_only_the_chosen_candidate_is_aligned_last_with_its_own_theta(recording, parts):
    aligned = []

    def align_last(state, theta, cloud, held):
        aligned.append((theta["drift_m"], state.positions[0, 0, 0], held))
        return state, (2.0, 1.0)

    def second(action, state, theta, follow_with):
        for drift in (3.0, 2.0, 5.0):
            follow_with({"drift_m": drift})
        return {"drift_m": 2.0}, Calibration.none()

    exchanged = replace(parts, calibrate=second, align_last=align_last)
    (action,) = tracked(recording, exchanged).actions
    end = action.positions_before_final_alignment[0, 0]
    assert aligned == [(2.0, end, False)]


def test_an_ablation_is_a_part_that_is_exchanged(recording):
    """An aligner that never corrects, handed in, is the mode without pseudo-actions."""
    config = TrackerConfig()
    config = replace(config, calibration=replace(config.calibration, method="none"))

    def tracker(config):
        return Tracker(recording, recording.cloth.template, config, partial(observe, recording))

    mine = tracker(config)
    mine.parts = replace(mine.parts, align=lambda predicted, observation: None)
    ablation = tracker(replace(config, use_pseudo_action=False))
    np.testing.assert_array_equal(mine.track().positions, ablation.track().positions)
    assert not np.array_equal(mine.track().positions, tracker(config).track().positions)


def test_dynamics_that_are_handed_in_make_their_own_predictions(recording):
    config = TrackerConfig()
    config = replace(config, calibration=replace(config.calibration, method="none"))
    tracker = Tracker(recording, recording.cloth.template, config, partial(observe, recording))
    ours, predicted = tracker.parts.dynamics, []

    def dynamics(theta):
        dyn = ours(theta)

        def mine(state, action, pseudo_action=None):
            if pseudo_action is None:
                predicted.append(action)
            return dyn(state, action, pseudo_action)

        return mine

    tracker.parts = replace(tracker.parts, dynamics=dynamics)
    tracker.track()
    (action,) = recording.actions
    assert len(predicted) >= action.last_frame - action.first_frame
