"""A picker whose times are wrong is noticed after an action, and by how much."""

import pytest

from clothtrack.live import live_action


def shifted(film, late_s):
    """The states and the run where a picker's times are so late."""
    tracker = film.tracker()
    (path,), states = film.recording.picker_paths.values(), []
    for index, frame in enumerate(film.recording.frames):
        for action in film.recording.actions:
            if action.last_frame == index:
                tracker.end_action()
            if action.first_frame == index:
                tracker.begin_action()
        then_s = min(max(frame.time_s - late_s, path.time_s[0]), path.time_s[-1])
        hand = {"gripper": (path.position_at(then_s), bool(path.closed_at(then_s)))}
        states.append(tracker.update(**(film.picture(index) | {"picker": hand})))
    rest = film.picture(len(film) - 1)
    for index in range(1, 4):
        states.append(tracker.update(**(rest | {"time_s": rest["time_s"] + 0.1 * index})))
        tracker._finisher.submit(int).result()  # whatever is made beside the stream is ready
    return states, tracker.close()


@pytest.mark.parametrize(("late_s", "clouds"), [(0.4, 40), (-0.4, 8)])
def test_wrong_times_are_told_with_their_size(film, late_s, clouds, monkeypatch):
    monkeypatch.setattr(live_action, "LAG_FRAMES", clouds)  # of a long action some are kept
    states, run = shifted(film, late_s)
    assert states[0].picker_lag_s == 0.0
    assert states[-1].picker_lag_s == pytest.approx(-late_s, abs=0.11)
    said = [note for state in states for note in state.notes if "closed picker" in note]
    assert len(said) == 1
    assert ("before" if late_s > 0 else "after") in said[0]
    assert run.provenance["live"]["picker_lag_s"] == states[-1].picker_lag_s


def test_right_times_are_not_doubted(film):
    states, run = shifted(film, 0.0)
    assert {state.picker_lag_s for state in states} == {0.0}
    assert run.provenance["live"]["picker_lag_s"] is None
