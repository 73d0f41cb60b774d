"""Which candidate is taken, and which frames judge it, without tracking anything."""

import numpy as np
import pytest

from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import PickAndPlace, PickerPath
from clothtrack.simulation.state import ClothState, ContactMemory
from clothtrack.tracking import calibration
from clothtrack.tracking.calibration import OutlineGap, TrackingCalibration
from clothtrack.tracking.configuration import ClothConfig
from clothtrack.tracking.picking import Grasp, HeldCloth
from clothtrack.tracking.protocols import Candidate, TrackedCandidate
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.tracked_trajectory import StepRecords

ACTION = PickAndPlace(0, 4, ("arm",))
PATH = PickerPath(np.array([0.0, 2.0]), np.array([[0.0, 0, 0], [0.1, 0, 0]]), np.full(2, True))
HELD = HeldCloth((Grasp("arm", PATH, np.array([0]), np.zeros((1, 3))),), np.zeros(3))
THETA = ClothConfig().theta()


def cloth(value):
    memory = ContactMemory(
        *(np.zeros(shape, kind) for shape, kind in (
            ((1, 4, 1), np.int32), ((1, 4, 1), np.float32), ((1, 4), np.int32), ((1, 4), np.int32),
        ))
    )  # fmt: skip
    still = np.zeros((1, 4, 3), np.float32)
    return ClothState(still + np.float32(value), still, memory)


def tracked(candidate, value=0.0):
    positions = np.full((4, 4, 3), value, np.float32)
    return TrackedCandidate(ACTION, candidate, positions, cloth(value), StepRecords.empty(4))


@pytest.mark.parametrize("wanted", [0.2, 0.5, 1.5])
def test_the_candidate_of_the_lowest_score_is_taken(wanted):
    def score(one):
        return 0.1 + abs(one.candidate.theta.table_friction - wanted)

    config = SearchConfig(axes={"table_friction": (0.2, 0.5, 1.5)}, stop_score=0.0)
    search = TrackingCalibration(lambda *_: HELD, config, score)(ACTION, cloth(0.0), THETA)
    for candidate in search:
        search.tell(tracked(candidate, candidate.theta.table_friction))
    best, state, record = search.result()
    assert best.candidate.theta.table_friction == wanted
    assert state.positions.max() == np.float32(wanted)
    assert record.candidates[record.best] == [wanted]
    assert sorted(record.candidates.ravel()) == [0.2, 0.5, 1.5]


def test_the_outline_is_compared_at_the_last_frames(write, tmp_path, square, monkeypatch):
    recording, asked, compared = write(tmp_path / "fold"), [], []
    nothing = Observation(np.zeros((0, 3)), recording.cameras, {}, None, np.zeros((0, 3)), 0.0)

    def observe(frame):
        asked.append(frame.index)
        return nothing

    def gap(mesh, vertices, seen, **_):
        compared.append(vertices.max())
        return 0.1 * len(compared)

    monkeypatch.setattr(calibration, "silhouette_gap", gap)
    candidate = tracked(Candidate(THETA, HELD))
    candidate.positions[:] = np.arange(1.0, 5.0)[:, None, None]  # the frame's number
    assert OutlineGap(recording, square, observe)(candidate) == pytest.approx(0.2)
    assert asked == compared == [4, 3, 2]
    candidate.positions[0, 0, 0] = np.nan
    assert OutlineGap(recording, square, observe)(candidate) == np.inf


def test_candidates_of_one_grasp_are_tracked_once():
    config = SearchConfig(axes={"held_layers": (1, 2, 8)}, stop_score=0.0)
    search = TrackingCalibration(lambda *_: HELD, config, lambda _: 0.1)(ACTION, cloth(0.0), THETA)
    candidates = []
    for candidate in search:
        candidates.append(candidate)
        search.tell(tracked(candidate))
    assert len(candidates) == 1
    assert search.result()[2].scores.tolist() == [0.1, 0.1, 0.1]
