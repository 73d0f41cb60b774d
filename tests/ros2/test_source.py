"""A driver in this process publishes over DDS what real ones do, and what they should not."""

import importlib.util
import logging
import os
import threading
import time
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np
import pytest
from import_makers import OPTICAL, START_NS, Film, Messages

from clothtrack.errors import InvalidConfigError, InvalidRecordingError

pytest.importorskip("cyclonedds", reason="the extra [ros2] brings it")

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import clothtrack_capture.ros2
from clothtrack_capture.importing.containers import Topic as ImportedTopic
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.ros2 import Ros2Source, Ros2SourceConfig, Ros2Topics
from clothtrack_capture.ros2.message_types import dds_type
from clothtrack_capture.ros2.robot_state import RobotState

MESSAGES = Messages(cdr=True)
FILM = Film()
STEP_NS = 20_000_000
CAMERA = Ros2Topics("/camera/depth", "/camera/color", "/camera/camera_info")
PATIENT = Ros2SourceConfig(patience_s=10.0)
HASTY = Ros2SourceConfig(patience_s=0.6)
LATCHED = ("/tf_static", "/arm/closed")
ABOVE = (0.0, 0.0, 0.7)


class Driver:
    """Publishes `messages_at(step)` every 20 ms, stamped a step of 20 ms apart."""

    def __init__(self, messages_at):
        self._messages_at, self._done = messages_at, threading.Event()
        self._thread = threading.Thread(target=self._drive, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()

    def _drive(self):
        participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        writers = {}
        for step in count():
            for name, message in self._messages_at(step):
                kind = dds_type(message.__msgtype__)
                if name not in writers:
                    qos = Qos(
                        Policy.Reliability.Reliable(duration(milliseconds=10)),
                        Policy.Durability.TransientLocal
                        if name in LATCHED
                        else Policy.Durability.Volatile,
                    )
                    topic = Topic(participant, f"rt{name}", kind)
                    writers[name] = DataWriter(participant, topic, qos=qos)
                writers[name].write(kind(bytes(MESSAGES.pack(message))))
            if self._done.wait(STEP_NS / 1e9):
                break
        for entity in [*writers.values(), participant]:
            entity.__del__()


def time_of(step):
    return START_NS + step * STEP_NS


def camera_at(step, *, distortion=(0.0,) * 5):
    """What a camera publishes; depth last."""
    time_ns, frame = time_of(step), step % FILM.frames
    return [
        (CAMERA.camera_info, MESSAGES.info(time_ns, FILM, d=distortion)),
        (CAMERA.color, MESSAGES.image(time_ns + 1_000_000, FILM.color[frame], "bgr8")),
        (CAMERA.depth, MESSAGES.image(time_ns, FILM.depth[frame], "16UC1")),
    ]


def steps_of(source, number):
    """The next pictures, each with the driver's step."""
    for _ in range(number):
        picture = source.take(5.0)
        step, rest = divmod(source.stamp_ns(picture.time_s) - START_NS, STEP_NS)
        assert rest == 0
        yield step, picture


def test_without_pose_and_world_the_camera_is_the_world(loopback):
    with Driver(camera_at), Ros2Source(CAMERA, config=PATIENT) as source:
        np.testing.assert_array_equal(source.camera.world_from_camera, np.eye(4))
        for step, picture in steps_of(source, 5):
            frame = step % FILM.frames
            np.testing.assert_array_equal(
                picture.depth, FILM.depth[frame] * np.float32(0.001), strict=True
            )
            np.testing.assert_array_equal(picture.color, FILM.color[frame][..., ::-1], strict=True)
            assert picture.picker is None
            assert picture.mask is None


def test_depth_alone_and_another_unit(loopback):
    topics = Ros2Topics(CAMERA.depth, None, CAMERA.camera_info)
    config = Ros2SourceConfig(patience_s=10.0, depth_unit_m=0.00025)
    with Driver(camera_at), Ros2Source(topics, config=config) as source:
        ((step, picture),) = steps_of(source, 1)
        expected = FILM.depth[step % FILM.frames] * np.float32(0.00025)
        np.testing.assert_array_equal(picture.depth, expected)
        assert picture.color is None


def test_distortion_is_taken_out_of_both_pictures(loopback):
    distortion = (0.2, -0.1, 0.01, 0.0, 0.0)
    k = FILM.matrix
    lens = Intrinsics(FILM.width, FILM.height, k[0], k[4], k[2], k[5], distortion)
    with (
        Driver(lambda step: camera_at(step, distortion=distortion)),
        Ros2Source(CAMERA, config=PATIENT) as source,
    ):
        ((step, picture),) = steps_of(source, 1)
        depth = FILM.depth[step % FILM.frames] * np.float32(0.001)
        color = np.ascontiguousarray(FILM.color[step % FILM.frames][..., ::-1])
        np.testing.assert_array_equal(picture.depth, lens.straighten(depth, nearest=True))
        np.testing.assert_array_equal(picture.color, lens.straighten(color))
        assert (picture.depth != depth).any()


def arm_at(step):
    """A base that stands in the world, a tool that moves in it, a camera above."""
    time_ns = time_of(step)
    return [
        *([("/tf_static", standing())] if step == 0 else []),
        ("/tf", MESSAGES.tf(time_ns, "base", "tool", (0.01 * step, 0.0, 0.2))),
        ("/arm/tip", MESSAGES.pose(time_ns, "base", (0.01 * step, 0.0, 0.2))),
        ("/arm/opening", MESSAGES.value("Float32", 0.08 if step % 4 < 2 else 0.01)),
        ("/arm/joints", joints(time_ns, 0.02 if step % 4 < 2 else 0.005)),
        *camera_at(step),
    ]


def standing():
    """What does not move, told once."""
    quarter = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    both = MESSAGES.tf(0, "world", "base", (1.0, 0.0, 0.0), quarter)
    both.transforms += MESSAGES.tf(0, "world", OPTICAL, ABOVE).transforms
    return both


def joints(time_ns, each):
    return MESSAGES.make(
        "sensor_msgs/msg/JointState", header=MESSAGES.header(time_ns, ""), name=["left", "right"],
        position=np.array([each, each]), velocity=np.zeros(0), effort=np.zeros(0),
    )  # fmt: skip


@pytest.mark.parametrize("where", [{"tool_frame": "tool"}, {"pose": "/arm/tip"}])
@pytest.mark.parametrize("gripper", ["/arm/opening", "/arm/joints"])
def test_camera_and_tool_are_put_into_the_world_by_tf(loopback, where, gripper):
    topics = Ros2Topics(
        CAMERA.depth, CAMERA.color, CAMERA.camera_info, gripper=gripper, world_frame="world",
        **where,
    )  # fmt: skip
    config = Ros2SourceConfig(patience_s=10.0, closed_below=0.02)
    with Driver(arm_at), Ros2Source(topics, config=config) as source:
        np.testing.assert_allclose(source.camera.world_from_camera[:3, 3], ABOVE)
        source.take(5.0)
        time.sleep(0.2)  # by now the robot has been heard, too
        list(steps_of(source, 1))
        seen = set()
        for step, picture in steps_of(source, 8):
            ((position, closed),) = picture.picker.values()
            # x of the base is y of the world.
            np.testing.assert_allclose(position, [1.0, 0.01 * step, 0.2], atol=1e-12)
            assert closed == (step % 4 >= 2)
            seen.add(closed)
        assert seen == {True, False}


def test_a_pose_that_stalls_is_reported_and_pictures_go_on(loopback, caplog):
    topics = Ros2Topics(CAMERA.depth, CAMERA.color, CAMERA.camera_info, pose="/arm/tip")
    stalls = threading.Event()

    def messages_at(step):
        arm = [("/arm/tip", MESSAGES.pose(time_of(step), "any", (0.1, 0.0, 0.2)))]
        return camera_at(step) if stalls.is_set() else [*arm, *camera_at(step)]

    with (
        caplog.at_level(logging.WARNING),
        Driver(messages_at),
        Ros2Source(topics, world_from_camera=np.eye(4), config=PATIENT) as source,
    ):
        assert wait_until(source, lambda picture: picture.picker is not None)
        stalls.set()
        last = wait_until(source, lambda picture: picture.picker is None)
        assert "/arm/tip has told nothing for 0.2 s" in caplog.text
        stalls.clear()
        back = wait_until(source, lambda picture: picture.picker is not None)
        assert back.time_s > last.time_s
        assert "known again" in caplog.text


def wait_until(source, true_of):
    """The first picture of which something is true, of the next hundred."""
    pictures = (source.take(5.0) for _ in range(100))
    return next(picture for picture in pictures if true_of(picture))


def test_a_pose_in_an_unknown_frame_gives_no_picker(caplog):
    robot = RobotState(Ros2Topics(pose="/arm/tip", world_frame="world"), PATIENT, world="world")
    tip = ImportedTopic("/arm/tip", "geometry_msgs/msg/PoseStamped", cdr=True)
    pose = MESSAGES.pose(START_NS, "base", (0.0, 0.0, 0.2))
    robot.note_pose(tip, bytes(MESSAGES.pack(pose)), START_NS)
    assert robot.picker(START_NS, START_NS) is None
    assert "nothing ties its frame 'base' to the world 'world'" in caplog.text


def test_iteration_ends_with_the_publisher(loopback):
    with Driver(camera_at) as driver:
        source = Ros2Source(CAMERA, config=PATIENT)
        pictures = iter(source)
        assert next(pictures).depth.shape == (FILM.height, FILM.width)
        driver._done.set()
    source._config = HASTY
    assert len(list(pictures)) <= 1
    source.close()


def test_another_thread_ends_the_waiting(loopback):
    with Driver(camera_at):
        source = Ros2Source(CAMERA, config=PATIENT)
    threading.Timer(0.3, source.close).start()
    start = time.monotonic()
    while source.take(20.0) is not None:
        pass
    assert time.monotonic() - start < 10.0
    assert list(source) == []


def silent_after(step):
    return camera_at(step) if step < 20 else [(CAMERA.camera_info, MESSAGES.info(0, FILM))]


def color_of_another_hour(step):
    camera = dict(camera_at(step))
    if step > 5:
        camera[CAMERA.color].header.stamp.sec += 3600
    return camera.items()


@pytest.mark.parametrize(
    ("messages_at", "told"),
    [
        (silent_after, r"no message on /camera/depth for 0\.6 s"),
        (color_of_another_hour, "none with a picture of /camera/color"),
    ],
)
def test_a_camera_that_goes_silent_is_an_error_that_says_so(loopback, messages_at, told):
    with Driver(messages_at), Ros2Source(CAMERA, config=PATIENT) as source:
        source._config = HASTY
        with pytest.raises(InvalidRecordingError, match=told):
            list(source)


def without_info(step):
    return camera_at(step)[0 if step == 0 else 1 :]


def unregistered(step, k1=0.0):
    camera = dict(camera_at(step, distortion=(k1, 0.0, 0.0, 0.0, 0.0)))
    camera[CAMERA.depth] = MESSAGES.image(time_of(step), FILM.depth[0][:-2], "16UC1")
    return camera.items()


@pytest.mark.parametrize(
    ("messages_at", "changes", "told"),
    [
        (
            camera_at, {"depth": "/camera/depht"},
            r"no message on /camera/depht for 3 s; topics seen: /camera/color \(Image\), "
            r"/camera/depth \(Image\), /camera/camera_info \(CameraInfo\); check the names",
        ),
        (without_info, {}, r"no message on /camera/camera_info for 3"),
        (
            camera_at, {"gripper": CAMERA.color},
            r"/camera/color is of type sensor_msgs/msg/Image; gripper is",
        ),
        (unregistered, {}, r"32 x 22 pixels, but .* says 32 x 24"),
        (partial(unregistered, k1=0.2), {}, r"32 x 22 pixels, but .* says 32 x 24"),
        (
            camera_at, {"depth": CAMERA.color},
            "/camera/color: encoding 'bgr8'; depth is one",
        ),
        (arm_at, {"gripper": "/arm/opening"}, "closed_below"),
        (
            arm_at, {"world_frame": "map"},
            r"'map' in 3 s; frames: base, .*world; give",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_with_what_can(loopback, messages_at, changes, told):
    with Driver(messages_at):
        time.sleep(0.1)  # what was sent before the source joined is gone
        with pytest.raises((InvalidRecordingError, InvalidConfigError), match=told):
            list(Ros2Source(replace(CAMERA, **changes), config=Ros2SourceConfig(patience_s=3.0)))


def test_a_picture_of_another_size_is_left_out_and_counted(loopback, caplog):
    def messages_at(step):
        camera = dict(camera_at(step))
        if step % 2:
            camera[CAMERA.color] = MESSAGES.image(time_of(step), FILM.color[0][:-2], "bgr8")
        return camera.items() if step > 10 else camera_at(step)

    with Driver(messages_at), Ros2Source(CAMERA, config=PATIENT) as source:
        late = [step for step, _ in steps_of(source, 15) if step > 10]
        assert late
        assert not any(step % 2 for step in late)
        assert source.counts.damaged > 0
    assert "a picture is left out (32 x 22 pixels" in caplog.text


def test_a_gripper_that_told_once_is_heard_by_who_comes_late(loopback):
    topics = Ros2Topics(
        CAMERA.depth, CAMERA.color, CAMERA.camera_info, pose="/arm/tip", gripper="/arm/closed"
    )

    def messages_at(step):
        once = [("/arm/closed", MESSAGES.value("Bool", True))] if step == 0 else []
        return [*once, *arm_at(step)]

    with (
        Driver(messages_at),
        Ros2Source(topics, world_from_camera=np.eye(4), config=PATIENT) as source,
    ):
        picture = wait_until(source, lambda picture: picture.picker is not None)
        ((_, closed),) = picture.picker.values()
        assert closed


def test_settings_that_mean_nothing_are_refused():
    with pytest.raises(InvalidConfigError, match="tolerance_s is -1"):
        Ros2SourceConfig(tolerance_s=-1.0)
    with pytest.raises(InvalidConfigError, match="give world_frame"):
        Ros2Source(Ros2Topics(tool_frame="tool"))


def test_a_domain_that_cannot_be_is_refused(loopback, monkeypatch):
    with pytest.raises(InvalidConfigError, match="DDS refuses domain 500"):
        Ros2Source(domain_id=500)
    monkeypatch.setenv("ROS_DOMAIN_ID", "kitchen")
    with pytest.raises(InvalidConfigError, match="ROS_DOMAIN_ID is 'kitchen'"):
        Ros2Source()


def test_without_the_extra_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InvalidConfigError, match=r"needs cyclonedds, rosbags.*ros2"):
        clothtrack_capture.ros2.__getattr__("Ros2Sink")
