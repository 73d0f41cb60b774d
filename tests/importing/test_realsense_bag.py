"""RealSense recordings, old and new, and the one genuine file."""

import re

import numpy as np
import pytest
from import_makers import color_of, depth_of, write_realsense_bag, write_realsense_db3
from rosbags.highlevel import AnyReader

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings.inspection import inspect
from clothtrack.recordings.pictures import read_depth
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.import_recording import import_recording, open_source


def test_the_pose_between_the_cameras_is_the_sensors_own(film, tmp_path):
    """`/tf_static` of the same file, in another convention, would move depth by half a meter."""
    source = write_realsense_db3(tmp_path / "film.db3", film, shift_m=0.015)
    opened = open_source(source, ImportOptions())
    opened.close()
    expected = np.eye(4)
    expected[0, 3] = 0.015
    assert np.allclose(opened.streams.calibration.color_from_depth, expected)


def test_an_old_recording_without_its_unit_asks(film, tmp_path):
    source = write_realsense_bag(tmp_path / "film.bag", film, units=None)
    with pytest.raises(InvalidRecordingError, match="--depth-unit-m"):
        import_recording(source, tmp_path / "out")
    chosen = ImportOptions(depth_unit_m=0.001)
    assert import_recording(source, tmp_path / "out", chosen).depth_unit_m == 0.001


@pytest.mark.data
def test_the_genuine_recording(data, tmp_path):
    """An office corner: 93 % of depth measured, median 1.478 m; depth not registered to color."""
    source = data / "realsense-d435-bag" / "single_depth_color_640x480.bag"
    if not source.is_file():
        pytest.skip("the genuine RealSense recording is not here")
    alone = import_recording(source, tmp_path / "alone", ImportOptions(without_color=True))
    assert alone.frames == 2
    with AnyReader([source]) as reader:
        raw = [
            np.asarray(reader.deserialize(data, one.msgtype).data).view("<u2").reshape(480, 640)
            for one, _, data in reader.messages()
            if one.topic.endswith("Depth_0/image/data")
        ]
    assert np.array_equal(depth_of(tmp_path / "alone"), raw)
    later = raw[1] * 0.001
    assert (later > 0).mean() == pytest.approx(0.93, abs=0.005)
    assert np.median(later[later > 0]) == pytest.approx(1.478, abs=0.001)

    with pytest.raises(InvalidRecordingError, match=r"--tolerance-s 0\.103 for 1 frame") as caught:
        import_recording(source, tmp_path / "both")
    proposed = float(str(caught.value).partition("--tolerance-s ")[2].split()[0])
    both = import_recording(source, tmp_path / "both", ImportOptions(tolerance_s=proposed))
    assert both.frames == 1
    assert inspect(tmp_path / "both").valid
    carried = read_depth(tmp_path / "both" / "depth" / "000000.png", 0.001)
    # The color camera sees a narrower part, almost all of it measured.
    assert (carried > 0).mean() > 0.95
    assert np.median(carried[carried > 0]) == pytest.approx(1.55, abs=0.03)


@pytest.mark.parametrize(
    ("write", "name"), [(write_realsense_db3, "film.db3"), (write_realsense_bag, "film.bag")]
)
def test_every_bit_of_new_and_old_recordings_arrives(write, name, film, tmp_path):
    report = import_recording(write(tmp_path / name, film), tmp_path / "out")
    assert np.array_equal(depth_of(tmp_path / "out"), film.depth)
    assert np.array_equal(color_of(tmp_path / "out"), film.color)
    assert report.depth_unit_m == 0.00025
    assert re.search("Depth.Units", report.depth_unit_origin)
