"""Candidates that are judged by tracking: followed once, and the one whose outline fits taken."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.tracking import algorithm
from clothtrack.tracking.calibration import CalibrationConfig
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.pipeline import RunConfig, track_recording

AXES = {"held_layers": (1.0, 2.0), "bend_compliance": (0.1, 10.0)}


@pytest.fixture(scope="module")
def config() -> TrackerConfig:
    search = CalibrationConfig(method="grid", judge="tracking", axes=AXES)
    base = TrackerConfig(average_candidates=False)
    return replace(base, calibration=search, solver=replace(base.solver, substep_s=3.3e-3))


def test_the_candidate_with_the_best_outline_is_the_one_that_is_tracked(recording, config):
    tracked = track_recording(recording, RunConfig(tracker=config))
    (action,) = tracked.actions
    found = action.calibration
    assert len(found.scores) == len(AXES["held_layers"]) * len(AXES["bend_compliance"])
    assert found.scores[found.best] == found.scores.min()
    assert 0.0 < found.scores.min() < 0.2
    taken = dict(zip(found.names, found.candidates[found.best].tolist(), strict=True))
    assert {name: action.parameters[name] for name in taken} == taken
    # The candidates part where the picker has moved the cloth, and hardly elsewhere.
    moved = np.linalg.norm(tracked.positions[-1] - tracked.positions[0], axis=1)
    still, carried = moved < np.quantile(moved, 0.2), moved > np.quantile(moved, 0.8)
    assert found.spread_m.shape == moved.shape
    assert found.spread_m[carried].mean() > 1.2 * found.spread_m[still].mean() > 0.0

    alone = replace(
        config,
        parameters={**config.parameters, **taken},
        calibration=replace(config.calibration, method="none"),
    )
    again = track_recording(recording, RunConfig(tracker=alone))
    np.testing.assert_array_equal(tracked.positions, again.positions)
    np.testing.assert_array_equal(tracked.steps.loss_after, again.steps.loss_after)


def test_where_one_layer_lies_no_second_one_is_tried(recording, config, monkeypatch):
    followed = []
    follow = algorithm.follow

    def counted(*arguments, **named):
        followed.append(arguments)
        return follow(*arguments, **named)

    monkeypatch.setattr(algorithm, "follow", counted)
    track_recording(recording, RunConfig(tracker=config))
    assert len(followed) == len(AXES["bend_compliance"])


def test_an_action_of_few_frames_is_judged_by_its_outline_alone(recording, config):
    """An open-loop roll-out needs as many clouds as are compared; the outline needs one."""
    axes = {"bend_compliance": (0.1, 10.0)}
    frames = len(recording.frames)
    for judge, judged in (("tracking", 2), ("open_loop", 0)):
        search = replace(config.calibration, judge=judge, axes=axes)
        few = replace(config, calibration=search, score_frames=frames + 1)
        (action,) = track_recording(recording, RunConfig(tracker=few)).actions
        assert len(action.calibration.scores) == judged
