"""The picker's path: from a table, a topic or TF; and the actions that it tells."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from import_makers import OPTICAL, START_NS, Film, Messages, stream, write_ros1, write_ros2
from scipy.spatial.transform import Rotation

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.recordings.recording import PickerPath, actions_of
from clothtrack.recordings.store import read_recording
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.import_recording import import_recording
from clothtrack_capture.importing.picker_paths import read_path_table
from clothtrack_capture.importing.transforms import TransformTree

ROS2 = Messages(cdr=True)
ROS1 = Messages(cdr=False)
FILM = Film(frames=10)
# The base stands 1 m in front of the camera and looks back: x right stays, y and z turn around.
BACK = (1.0, 0.0, 0.0, 0.0)


def tip(k):
    return (0.01 * k, 0.02 * k, 0.3)


def seen(k):
    """The tip in the camera's frame."""
    x, y, z = tip(k)
    return np.array([x, -y, 1.0 - z])


def bag(path, messages, write=write_ros2, *, log_delay_ns=0, values=None, joints=False):
    entries = list(stream(FILM, messages, log_delay_ns=log_delay_ns))
    entries.insert(
        0, ("/tf_static", START_NS, messages.tf(START_NS, OPTICAL, "base", (0, 0, 1), BACK))
    )
    for k, time in enumerate(FILM.times.tolist()):
        log = time + log_delay_ns
        entries.append(("/tip", log, messages.pose(time, "base", tip(k))))
        entries.append(("/tf", log, messages.tf(time, "base", "hand", (0, 0, 0.4))))
        x, y, z = tip(k)
        entries.append(("/tf", log, messages.tf(time, "hand", "tool", (x, y, z - 0.4))))
        closed = 3 <= k < 6
        if joints:
            state = messages.make(
                "sensor_msgs/msg/JointState", header=messages.header(time),
                name=["left", "right"], position=np.array([0.0, 0.001] if closed else [0.04, 0.04]),
                velocity=np.zeros(0), effort=np.zeros(0),
            )  # fmt: skip
            entries.append(("/gripper", log, state))
        else:
            entries.append(("/gripper", log, messages.value("Bool", closed)))
    return write(path, entries, messages)


@pytest.mark.parametrize("chosen", [
    ImportOptions(picker_topic="/tip", gripper_topic="/gripper"),
    ImportOptions(picker_frame="tool", gripper_topic="/gripper"),
])  # fmt: skip
@pytest.mark.parametrize("messages", [ROS1, ROS2], ids=["ros 1", "ros 2"])
def test_topic_and_tf_give_the_same_path(chosen, messages, tmp_path):
    source = bag(tmp_path / "bag", messages, write_ros2 if messages.cdr else write_ros1)
    report = import_recording(source, tmp_path / "out", chosen)
    recording = read_recording(tmp_path / "out")
    path = recording.picker_paths["picker"]
    for k, frame in enumerate(recording.frames):
        assert np.allclose(path.position_at(frame.time_s), seen(k), atol=1e-9)
        assert path.closed_at(frame.time_s) == (3 <= k < 6)
    # From the last frame before it closes (at frame 3 it is closed) to the first after it opens.
    assert [(one.first_frame, one.last_frame) for one in recording.actions] == [(3, 6)]
    assert not any("picker" in one for one in report.missing)


def test_finger_joints_need_a_limit(tmp_path):
    source = bag(tmp_path / "bag", ROS2, joints=True)
    chosen = ImportOptions(picker_topic="/tip", gripper_topic="/gripper")
    with pytest.raises(InvalidConfigError, match="--gripper-closed-below"):
        import_recording(source, tmp_path / "out", chosen)
    limited = ImportOptions(
        picker_topic="/tip", gripper_topic="/gripper", gripper_closed_below=0.01
    )
    report = import_recording(source, tmp_path / "out", limited)
    assert report.actions == [(3, 6)]
    in_millimeters = replace(limited, gripper_closed_below=10.0)
    report = import_recording(source, tmp_path / "other", in_millimeters)
    assert any("closed all the time" in note for note in report.notes)
    with pytest.raises(InvalidRecordingError, match="is a recording already; use it as it is"):
        import_recording(tmp_path / "out", tmp_path / "again", limited)
    with pytest.raises(InvalidConfigError, match="--tolerance-s is 16 s, at most 1"):
        import_recording(source, tmp_path / "again", replace(limited, tolerance_s=16.0))


def test_a_path_that_nothing_ties_to_the_camera(tmp_path):
    entries = [*stream(FILM, ROS2)]
    for k, time in enumerate(FILM.times.tolist()):
        entries.append(("/tip", time, ROS2.pose(time, "base", tip(k))))
    source = write_ros2(tmp_path / "bag", entries, ROS2)
    chosen = ImportOptions(picker_topic="/tip")
    with pytest.raises(InvalidConfigError, match="--world-from-camera"):
        import_recording(source, tmp_path / "out", chosen)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(BACK).as_matrix(), [0, 0, 1]
    file = tmp_path / "pose.json"
    file.write_text(json.dumps(pose.tolist()))
    import_recording(source, tmp_path / "out", replace(chosen, world_from_camera=file))
    recording = read_recording(tmp_path / "out")
    assert np.allclose(recording.cameras[0].world_from_camera, pose)
    assert np.allclose(recording.picker_paths["picker"].positions[3], tip(3))


@pytest.mark.parametrize(
    ("chosen", "word"),
    [
        (ImportOptions(picker_topic="/nobody"), "/nobody"),
        (ImportOptions(picker_frame="nobody"), "tool"),
        (ImportOptions(gripper_topic="/gripper"), "--picker-topic"),
        (ImportOptions(picker_topic="/tip", gripper_topic="/nobody"), "/nobody"),
        (ImportOptions(picker_frame="tool", world_frame="nobody"), "nobody"),
        (ImportOptions(picker_topic="/tip", picker_frame="tool"), "one of them"),
    ],
)
def test_what_is_not_there_is_named(chosen, word, tmp_path):
    source = bag(tmp_path / "bag", ROS2)
    with pytest.raises(InvalidConfigError, match=word):
        import_recording(source, tmp_path / "out", chosen)
    assert not list(tmp_path.glob(".out*"))


def table(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        "time_s,picker,x_m,y_m,z_m,closed\n0.1,picker,1,2,3,0\n0.2,picker,4,5,6,1\n",
        "time,x,y,z,closed\n0.1,1,2,3,0\n0.2,4,5,6,1\n",
        "Z, t ,y,x,closed,more\n3,0.1,2,1,false,9\n6,0.2,5,4,TRUE,9\n",
    ],
)
def test_tables(text, tmp_path):
    path = read_path_table(table(tmp_path / "path.csv", text))[0]["picker"]
    assert path.time_s.tolist() == [0.1, 0.2]
    assert path.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert path.closed.tolist() == [False, True]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "time"), ("time,x,y\n1,2,3\n", "without z"), ("time,x,y,z\n1,2,3,4\n", "at least two"),
        ("time,x,y,z\n1,2,3,nan\n2,2,2,2\n", "line 2"), ("time,x,y,z\n2,1,1,1\n1,1,1,1", "line 3"),
        ("time,x,y,z\n1,2\n", "line 2"), ('time,x,y,z\n"1,2,3,4\n' + "5" * 200_000, "CSV"),
    ],
)  # fmt: skip
def test_wrong_tables_are_named(text, word, tmp_path):
    with pytest.raises(InvalidRecordingError, match=word):
        read_path_table(table(tmp_path / "path.csv", text))


@pytest.mark.parametrize("clock", ["recording", "source"])
def test_the_clock_of_a_table(clock, tmp_path):
    source = write_ros2(tmp_path / "bag", stream(FILM, ROS2), ROS2)
    start = 0.0 if clock == "recording" else START_NS / 1e9
    rows = [f"{start + 0.05 * k:.6f},0,0,0.1,{int(2 <= k < 4)}" for k in range(8)]
    file = table(tmp_path / "path.csv", "time,x,y,z,closed\n" + "\n".join(rows) + "\n")
    report = import_recording(
        source, tmp_path / "out", ImportOptions(picker_csv=file, picker_clock=clock)
    )
    # Closed from 0.1 to 0.2 s; frames come every 1/30 s.
    assert report.actions == [(3, 6)]
    if clock == "source":
        with pytest.raises(InvalidConfigError, match="--picker-clock"):
            import_recording(source, tmp_path / "other", ImportOptions(picker_csv=file))


def test_every_closure_is_inside_its_action(rng):
    frames = np.sort(rng.uniform(0, 10, 60))
    samples = np.sort(rng.uniform(-1, 11, 500))
    path = PickerPath(samples, np.zeros((500, 3)), np.sin(2 * samples) > 0.3)
    actions, _ = actions_of({"arm": path}, frames.tolist())
    for one, after in pairwise(actions):
        assert one.last_frame <= after.first_frame
    inside = np.zeros(len(frames), bool)
    for one in actions:
        inside[one.first_frame : one.last_frame + 1] = True
    shut = np.array([path.closed_at(time) for time in frames])
    covered = (frames >= samples[0]) & (frames <= samples[-1])
    assert inside[shut & covered].all()


def test_transforms_against_products(rng):
    """root -> a -> b and root -> c; b seen from c at the times of the samples."""
    tree = TransformTree()
    times = 1_000_000_000 + np.arange(5) * 100_000_000

    def told(parent, child, static):
        matrices = []
        for time in times[:1] if static else times:
            quaternion, shift = Rotation.random(random_state=rng).as_quat(), rng.normal(size=3)
            tree.add(parent, child, int(time), shift.tolist(), quaternion.tolist(), static=static)
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), shift
            matrices.append(matrix)
        return np.array(matrices * (5 if static else 1))

    a, b, c = told("root", "a", False), told("a", "b", True), told("root", "c", False)
    expected = np.linalg.inv(c) @ a @ b
    assert np.allclose(tree.lookup("c", "b", times), expected, atol=1e-9)
    assert np.array_equal(tree.moments("c", "b"), times)
    assert tree.connects("/c", "b")
    assert not tree.connects("c", "elsewhere")


def test_actions_told_by_hand(tmp_path):
    source = bag(tmp_path / "bag", ROS2)
    config = ImportOptions(picker_topic="/tip", actions=("1-4", "4-9"))
    assert import_recording(source, tmp_path / "out", config).actions == [(1, 4), (4, 9)]
    for words in (("x",), ("5-5",), ("0-99",), ("0-5", "4-8")):
        with pytest.raises(InvalidConfigError, match="--actions"):
            import_recording(source, tmp_path / "no", replace(config, actions=words))
