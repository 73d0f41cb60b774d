"""Algorithm 1 with functions of a few lines: what it asks of each, and in which order."""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest

from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.tracking.algorithm import track
from clothtrack.tracking.calibration import Uncalibrated
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.feature_anchors import no_anchors
from clothtrack.tracking.final_alignment import no_final_alignment
from clothtrack.tracking.protocols import Candidate, Corrected, Correction, Method
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.rest import never_at_rest
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration
from clothtrack.tracking.tracker import Tracker
from clothtrack.tracking.visible_alignment import no_alignment


def drift(meters: float) -> Theta:
    """Parameters of a cloth whose table friction is its drift [m per frame]."""
    return Theta(0.0, 0.0, meters, 0.0, 0)


@dataclass(frozen=True)
class Cloth:
    """State and prediction of a cloth that drifts along x, as fast as theta says [m per frame]."""

    positions: np.ndarray
    started_at: np.ndarray | None = None
    highest_speed: np.ndarray = field(default_factory=lambda: np.zeros(1))
    exact: bool = True

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
        return (theta,)


class Drifting:
    """Dynamics that do nothing but drift."""

    def __init__(self, theta):
        self.drift_m = theta.table_friction

    def __call__(self, state, action, pseudo_action=None):
        return Cloth(state.positions + [self.drift_m, 0, 0], state.positions)

    predict = __call__


def to_the_origin(predicted, observation):
    start = predicted.positions[0]
    return Correction(start, -start, np.ones(len(start), bool), (1.0, 0.0))


def half(dyn, state, action, predicted, correction):
    if correction is None:
        return Corrected(predicted)
    return Corrected(Cloth((correction.start + 0.5 * correction.displacement)[None]), 0.5, 2)


@pytest.fixture
def method(recording):
    return Method(
        observe=partial(observe, recording),
        calibrate=Uncalibrated(lambda action, state, theta: Nothing()),
        dynamics=Drifting,
        align=to_the_origin,
        line_search=half,
        align_last=no_final_alignment,
        anchor=no_anchors,
        at_rest=never_at_rest,
    )


class Several:
    """A search through three drifts, which chooses one."""

    def __init__(self, chosen):
        self.chosen, self.told = chosen, {}

    def __iter__(self):
        for meters in (3.0, 2.0, 5.0):
            yield Candidate(drift(meters), Nothing())
            # Each candidate is told before the next is asked.
            assert list(self.told)[-1] == meters

    def tell(self, tracked):
        self.told[tracked.candidate.theta.table_friction] = tracked

    def result(self):
        best = self.told[self.chosen]
        return best, best.state, Calibration.none()


def tracked(recording: Recording, method: Method, theta=None, watch=None):
    mesh = recording.cloth.template
    start = Cloth(np.zeros((1, len(mesh.vertices), 3)))
    recorder = Recorder(recording, mesh, start, lambda each: np.ones(len(each), bool), watch=watch)
    track(recording, start, theta or drift(1.0), recorder.timed(method), recorder)
    return recorder.trajectory()


def test_every_frame_is_predicted_then_corrected(recording, method):
    """x_{t+1} = (x_t + 1) / 2: the drift of a frame and half of the way back."""
    (action,) = recording.actions
    result = tracked(recording, method)
    at = np.arange(len(recording.frames))
    expected = 1.0 - 0.5 ** np.clip(at - action.first_frame, 0, action.last_frame)
    np.testing.assert_allclose(result.positions[:, 0, 0], expected, rtol=1e-6)
    within = slice(action.first_frame + 1, action.last_frame + 1)
    assert (result.steps.correction_scale[within] == 0.5).all()
    assert np.isfinite(result.steps.predict_s[within]).all()
    assert np.isnan(result.steps.loss_after[action.first_frame])


def test_without_a_correction_the_dynamics_go_on_alone(recording, method):
    result = tracked(recording, replace(method, align=no_alignment))
    (action,) = recording.actions
    steps = action.last_frame - action.first_frame
    np.testing.assert_allclose(result.positions[-1, :, 0], steps)
    assert not result.steps.trials.any()


def test_the_final_alignment_is_what_the_next_action_starts_from(recording, method):
    lifted = replace(
        method,
        align_last=lambda state, theta, cloud, held: (
            Cloth(state.positions + [0, 0, 7]),
            (2.0, 1.0),
        ),
    )
    (action,) = tracked(recording, lifted).actions
    assert (action.positions_before_final_alignment[:, 2] == 0.0).all()
    assert (action.positions_after_final_alignment[:, 2] == 7.0).all()
    assert tuple(action.final_alignment_losses) == (2.0, 1.0)


def test_every_candidate_is_tracked_from_the_same_state_and_the_others_leave_nothing(
    recording, method
):
    search = Several(chosen=2.0)
    result = tracked(recording, replace(method, calibrate=lambda *_: search))
    assert list(search.told) == [3.0, 2.0, 5.0]
    assert result.actions[0].parameters["table_friction"] == 2.0
    alone = tracked(recording, method, drift(2.0))
    np.testing.assert_array_equal(result.positions, alone.positions)
    ends = [one.positions[-1, 0, 0] for one in search.told.values()]
    assert ends[1] < ends[0] < ends[2]


def test_only_the_chosen_candidate_is_aligned_last_with_its_own_theta(recording, method):
    aligned = []

    def align_last(state, theta, cloud, held):
        aligned.append((theta.table_friction, state.positions[0, 0, 0], held))
        return state, (2.0, 1.0)

    exchanged = replace(method, calibrate=lambda *_: Several(2.0), align_last=align_last)
    (action,) = tracked(recording, exchanged).actions
    end = action.positions_before_final_alignment[0, 0]
    assert aligned == [(2.0, end, False)]


ONE_CANDIDATE = RunConfig(search=SearchConfig(method="none"))


def tracker(recording: Recording) -> Tracker:
    return Tracker(recording, recording.cloth.template, ONE_CANDIDATE, partial(observe, recording))


def test_a_mesh_at_rest_stays_and_is_compared_with_the_frame_that_it_was_moved_into(
    recording, method
):
    (action,) = recording.actions
    asked = []

    def at_rest(picker_action, tracked_at, frame):
        asked.append((tracked_at.index, frame.index))
        return frame.index > action.first_frame + 2

    result = tracked(recording, replace(method, at_rest=at_rest))
    moved = action.first_frame + 2
    assert asked[:4] == [(moved - 2, moved - 1), (moved - 1, moved), (moved, moved + 1),
                         (moved, moved + 2)]  # fmt: skip
    assert (result.positions[moved:, 0] == result.positions[moved, 0]).all()
    assert (result.positions[moved, 0] != result.positions[moved - 1, 0]).any()
    assert np.isnan(result.steps.predict_s[moved + 1 :]).all()
