"""A recording backwards, and forwards again."""

import numpy as np

from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import PickerPath
from clothtrack.recordings.reversal import reversed_path, reversed_recording
from clothtrack.recordings.store import read_recording


def test_the_last_frame_comes_first_and_the_picker_goes_back(write, tmp_path):
    forwards = write(tmp_path / "one")
    backwards = reversed_recording(forwards, tmp_path / "back" / "one")
    assert read_recording(tmp_path / "back" / "one").frames == backwards.frames
    last = len(forwards.frames) - 1
    assert len(backwards.frames) == last + 1
    end_s = forwards.frames[-1].time_s
    for frame, other in zip(backwards.frames, forwards.frames[::-1], strict=True):
        assert np.isclose(frame.time_s, end_s - other.time_s)
        assert np.array_equal(read_color(frame.color["top"]), read_color(other.color["top"]))
        assert np.array_equal(
            read_depth(frame.depth["top"], 0.001), read_depth(other.depth["top"], 0.001)
        )
        assert np.array_equal(read_mask(frame.mask["top"]), read_mask(other.mask["top"]))
    spans = [(one.first_frame, one.last_frame) for one in forwards.actions]
    assert [(one.first_frame, one.last_frame) for one in backwards.actions] == [
        (last - end, last - start) for start, end in spans[::-1]
    ]
    path, other = backwards.picker_paths["arm"], forwards.picker_paths["arm"]
    for moment in (0.1, 0.7, 1.3, 1.9):
        assert np.allclose(path.position_at(moment), other.position_at(end_s - moment))
        assert path.closed_at(moment) == other.closed_at(end_s - moment)
    assert np.array_equal(backwards.table.point, forwards.table.point)
    assert backwards.observed == forwards.observed
    assert backwards.provenance == {"made_by": "test", "reversed": "one"}


def test_a_template_lies_where_the_cloth_is_no_longer(write, tmp_path):
    backwards = reversed_recording(write(tmp_path / "one"), tmp_path / "two")
    assert backwards.cloth.template is None
    assert not backwards.cloth.held_vertices
    assert backwards.cloth.size_m == (0.1, 0.1)


def test_one_that_is_there_is_not_written_again(write, tmp_path):
    forwards = write(tmp_path / "one")
    reversed_recording(forwards, tmp_path / "two")
    written = (tmp_path / "two" / "recording.json").stat().st_mtime_ns
    reversed_recording(forwards, tmp_path / "two")
    assert (tmp_path / "two" / "recording.json").stat().st_mtime_ns == written


def test_twice_backwards_is_forwards():
    path = PickerPath(
        np.array([0.0, 0.5, 1.5, 2.0]), np.arange(12.0).reshape(4, 3),
        np.array([False, True, True, False]),
    )  # fmt: skip
    back = reversed_path(path, 2.0)
    assert back.closed.tolist() == [True, True, False, False]
    again = reversed_path(back, 2.0)
    assert np.allclose(again.time_s, path.time_s)
    assert np.array_equal(again.positions, path.positions)
    # After the last sample there is nothing that could be turned around.
    assert again.closed[:-1].tolist() == path.closed[:-1].tolist()
