"""A stream serves the newest picture, counts the rest, and says what has stalled."""

import threading
import time

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.live.live_stream import STALL_S


class Seen:
    """Keeps the states, and lets the stream go on only when told."""

    def __init__(self):
        self.states, self.go = [], threading.Event()
        self.go.set()
        self.came = threading.Condition()

    def __call__(self, state):
        with self.came:
            self.states.append(state)
            self.came.notify_all()
        assert self.go.wait(20)

    def wait_for(self, true):
        with self.came:
            assert self.came.wait_for(lambda: any(map(true, self.states)), 20)
        return next(filter(true, self.states))


def test_the_newest_picture_is_served_and_the_others_are_dropped(film):
    seen, tracker = Seen(), film.tracker()
    with ct.LiveStream(tracker, seen) as stream:
        seen.go.clear()
        stream.put(**film.picture(0))
        seen.wait_for(lambda state: state.frame == 0)
        for index in (1, 2, 3):
            picture = film.picture(index)
            stream.put(**picture)
            picture["depth"][:] = 0.0  # a driver uses its buffer again
        seen.go.set()
        stream.wait()
    # A slow machine may say that the camera stalls, with the state that it has.
    assert list(dict.fromkeys(state.frame for state in seen.states)) == [0, 3]
    assert seen.states[-1].dropped == 2
    assert stream.state is seen.states[-1]
    assert len(tracker.close().frames) == 4


def test_camera_and_picker_that_send_nothing_are_named_and_may_come_back(film):
    seen, tracker = Seen(), film.tracker()
    (name,) = film.recording.picker_paths
    with ct.LiveStream(tracker, seen) as stream:
        silent_s = time.monotonic()
        stream.put(**film.picture(0))
        stalled = seen.wait_for(lambda state: "camera" in state.stalled)
        assert set(stalled.stalled) == {"camera", name}
        assert time.monotonic() - silent_s > STALL_S
        assert stalled.frame == 0
        stream.put(**film.picture(1))
        stream.wait()
        back = seen.wait_for(lambda state: state.frame == 1)
        assert "camera" not in back.stalled


def test_what_goes_wrong_with_a_picture_is_raised_by_the_stream(film):
    stream = ct.LiveStream(film.tracker())
    stream.put(**film.picture(0))
    stream.wait()
    stream.put(**(film.picture(1) | {"depth": np.zeros((2, 2))}))
    with pytest.raises(ct.InvalidRecordingError, match="has shape"):
        stream.stop()
    with pytest.raises(ct.InvalidRecordingError, match="has shape"):
        stream.put(**film.picture(2))


def test_a_block_that_raises_ends_the_thread(film):
    with pytest.raises(ZeroDivisionError), ct.LiveStream(film.tracker()) as stream:
        raise ZeroDivisionError
    with pytest.raises(ct.InvalidConfigError, match="stopped"):
        stream.put(**film.picture(0))
