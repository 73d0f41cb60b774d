"""Color and depth by time stamp: nearest, each once, within the tolerance."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.source import StreamFrame
from clothtrack_capture.importing.times import pair

FILM = Path("film.bag")
MS = 1_000_000


def frames(times_ms):
    return [StreamFrame(round(time * MS), k) for k, time in enumerate(times_ms)]


def within(tolerance_s):
    return ImportOptions(tolerance_s=tolerance_s)


times = st.lists(st.integers(0, 2000), min_size=1, max_size=30, unique=True)


@settings(max_examples=200, deadline=None)
@given(times, times, st.integers(1, 50))
def test_laws_of_a_pairing(depth, color, tolerance_ms):
    try:
        paired = pair(FILM, frames(depth), frames(color), within(tolerance_ms / 1e3))
    except InvalidRecordingError:
        assert min(abs(d - c) for d in depth for c in color) > tolerance_ms
        return
    pairs = [(one.depth.time_ns // MS, one.color.time_ns // MS) for one in paired.pairs]
    assert pairs == sorted(pairs)
    for side, every in ((0, depth), (1, color)):
        used = [one[side] for one in pairs]
        assert len(set(used)) == len(used)
        assert set(used) <= set(every)
    for d, c in pairs:
        assert abs(d - c) <= tolerance_ms
        assert abs(d - c) == min(abs(d - other) for other in color)
        assert abs(d - c) == min(abs(c - other) for other in depth)
    assert paired.depth_alone == len(depth) - len(pairs)
    assert paired.color_alone == len(color) - len(pairs)
    assert paired.worst_s == pytest.approx(max(abs(d - c) for d, c in pairs) / 1e3)


def test_the_usual_tolerance_is_half_the_time_between_depth_pictures():
    depth = np.arange(10) * 40.0
    paired = pair(FILM, frames(depth), frames(depth + 19), ImportOptions())
    assert paired.tolerance_s == pytest.approx(0.02)
    assert len(paired.pairs) == 10
    with pytest.raises(InvalidRecordingError, match="--tolerance-s"):
        pair(FILM, frames(depth[:2]), frames([1000.0]), ImportOptions())


def test_a_constant_offset_is_met_by_the_tolerance_that_is_proposed():
    """One pair is near by chance; the flag in the report takes in the other ones."""
    depth = np.arange(9) * 100.0
    color = np.append(10.0, depth + 40.0)
    paired = pair(FILM, frames(depth), frames(color), within(0.02))
    assert len(paired.pairs) == 1
    proposed, count = paired.advice.split()[1], int(paired.advice.split()[3])
    assert count == 8
    more = pair(FILM, frames(depth), frames(color), within(float(proposed)))
    assert len(more.pairs) == 9
    assert more.advice == ""


def test_depth_alone_and_nothing_to_pair():
    paired = pair(FILM, frames([5.0, 0.0]), None, ImportOptions())
    assert [(one.depth.time_ns, one.color) for one in paired.pairs] == [(0, None), (5 * MS, None)]
    for depth, color in (([], [1.0]), ([1.0], [])):
        with pytest.raises(InvalidRecordingError, match="not one whole"):
            pair(FILM, frames(depth), frames(color), ImportOptions())
