"""Another process plays a recording as ROS 2 messages over DDS, and receives the meshes."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording

pytest.importorskip("cyclonedds", reason="the extra [ros2] brings it")

from clothtrack_capture import live_ros2
from clothtrack_capture.ros2 import Ros2Sink, Ros2Source, Ros2SourceConfig, Ros2Topics

PLAYER = Path(__file__).with_name("dds_player.py")
START_NS = 1_700_000_000_123_456_789
TOPICS = Ros2Topics(
    "camera/depth", "camera/color", "camera/camera_info", pose="arm/tip", gripper="arm/closed"
)
PACED, BURST = 6, 4
WAIT_S = 20.0


def mesh_of(recording, frame):
    """The template, moved on with every picture, and numbers that differ for every vertex."""
    template: ClothMesh = recording.cloth.template
    count = len(template.vertices)
    error = np.linspace(0.0, 0.06, count)
    error[::7] = np.nan
    visible = (np.arange(count) + frame) % 3 > 0
    return template.vertices + 0.01 * frame, template.faces, error, visible


def sockets_of(process):
    """Local addresses of the UDP sockets of a process."""
    held = {str(one.readlink()) for one in Path(f"/proc/{process}/fd").iterdir() if one.exists()}
    rows = [line.split() for line in Path(f"/proc/{process}/net/udp").read_text().splitlines()[1:]]
    hexadecimal = {row[1].split(":")[0] for row in rows if f"socket:[{row[9]}]" in held}
    return {".".join(str(byte) for byte in bytes.fromhex(one)[::-1]) for one in hexadecimal}


@pytest.fixture
def play(loopback, tmp_path):
    """Starts the player of a recording; the file of what it received, and its process."""
    started = []

    def start(recording, *encodings, paced=PACED, burst=BURST):
        out = tmp_path / "received.npz"
        command = [sys.executable, PLAYER, recording.folder, out, *encodings, paced, burst]
        started.append(
            subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, text=True)
        )
        return out, started[-1]

    yield start
    for player in started:
        player.kill()
        player.communicate()


@pytest.mark.parametrize("encodings", [("16UC1", "rgb8"), ("32FC1", "bgr8")])
def test_what_is_sent_arrives_bit_by_bit_and_so_does_the_mesh(play, encodings):
    recording = read_recording(shipped_recording())
    (camera,) = recording.cameras
    config = Ros2SourceConfig(patience_s=WAIT_S)
    published = []
    with Ros2Sink() as sink:
        out, player = play(recording, *encodings)
        with Ros2Source(
            TOPICS, world_from_camera=camera.world_from_camera, config=config
        ) as source:
            assert sockets_of("self") | sockets_of(player.pid) == {"0.0.0.0", "127.0.0.1"}
            for name in ("width", "height", "fx", "fy", "cx", "cy"):
                assert getattr(source.camera, name) == getattr(camera, name)
            np.testing.assert_array_equal(source.camera.world_from_camera, camera.world_from_camera)
            for index in [*range(PACED), PACED + BURST - 1]:
                if index >= PACED:
                    # Late: by now all of the burst has come, and only the newest counts.
                    assert player.stdout.readline() == "all sent\n"
                    time.sleep(0.5)
                stamp_ns = check_picture(source, recording, index)
                published.append(mesh_of(recording, index))
                sink.publish(stamp_ns, *published[-1])
            assert source.counts.late == BURST - 1
            assert source.counts.alone == source.counts.damaged == 0
        assert player.wait(WAIT_S) == 0
        assert sink.skipped == 0
    check_received(np.load(out), recording, published)


@pytest.mark.slow
def test_the_verb_tracks_what_is_sent_as_a_tracker_does_and_publishes_its_meshes(play, tmp_path):
    recording = read_recording(shipped_recording())
    (camera,) = recording.cameras
    out, player = play(recording, "16UC1", "rgb8", paced=PACED, burst=1)
    result = live_ros2(
        tmp_path / "live.zarr", depth="camera/depth", color="camera/color",
        camera_info="camera/camera_info", pose="arm/tip", gripper="arm/closed",
        cloth=recording.cloth, world_from_camera=camera.world_from_camera, table=recording.table,
        config=Ros2SourceConfig(patience_s=WAIT_S),
    )  # fmt: skip
    assert player.wait(WAIT_S) == 0
    assert "ms median" in result.text()
    tracker = ct.LiveTracker(recording.cloth, camera, table=recording.table)
    path = recording.picker_paths["gripper"]
    wanted = [
        tracker.update(
            (round(frame.time_s * 1e9) + START_NS - START_NS) / 1e9,
            read_depth(frame.depth["top"], 0.001),
            read_color(frame.color["top"]),
            picker={"gripper": (path.positions[frame.index], bool(path.closed[frame.index]))},
        )
        for frame in recording.frames[: PACED + 1]
    ]
    received = np.load(out)
    for vertices, state in zip(received["vertices"], wanted, strict=True):
        np.testing.assert_array_equal(vertices, state.positions)
    run = ct.load(tmp_path / "live.zarr")
    assert len(run.frames) == PACED + 1
    np.testing.assert_array_equal(run.positions, tracker.close().positions)


def test_a_tool_without_a_world_and_a_result_that_is_there_are_refused(loopback, tmp_path):
    with pytest.raises(ct.InvalidConfigError, match="world-frame"):
        live_ros2(tmp_path / "live.zarr", pose="arm/tip")
    with pytest.raises(ct.InvalidConfigError, match="is there already"):
        live_ros2(tmp_path)


def check_picture(source, recording, index):
    """Compare the next picture with a frame of the recording; its stamp."""
    picture, frame = source.take(WAIT_S), recording.frames[index]
    stamp_ns = START_NS + round(frame.time_s * 1e9)
    assert set(vars(picture)) == {"time_s", "depth", "color", "mask", "picker"}
    assert source.stamp_ns(picture.time_s) == stamp_ns
    assert picture.time_s == (stamp_ns - START_NS) / 1e9
    depth, color = read_depth(frame.depth["top"], 0.001), read_color(frame.color["top"])
    np.testing.assert_array_equal(picture.depth, depth, strict=True)
    np.testing.assert_array_equal(picture.color, color, strict=True)
    path = recording.picker_paths["gripper"]
    ((position, closed),) = picture.picker.values()
    np.testing.assert_array_equal(position, path.positions[index])
    assert closed == path.closed[index]
    return stamp_ns


def check_received(received, recording, published):
    times = [recording.frames[k].time_s for k in [*range(PACED), PACED + BURST - 1]]
    assert received["stamps"].tolist() == [START_NS + round(time_s * 1e9) for time_s in times]
    assert (received["frames"] == "world").all()
    for k, (positions, faces, error, visible) in enumerate(published):
        np.testing.assert_array_equal(received["corners"][k], positions[faces].reshape(-1, 3))
        np.testing.assert_array_equal(received["vertices"][k], positions.astype(np.float32))
        np.testing.assert_array_equal(received["errors"][k], error.astype(np.float32))
        np.testing.assert_array_equal(received["visible"][k], visible)
        colors = received["colors"][k].reshape(-1, 3, 4)
        np.testing.assert_array_equal(colors[..., 3], np.where(visible[faces], 1.0, 0.5))
        # Red grows with the error, and what is not known is gray.
        worst, best = (faces == np.nanargmax(error)), (faces == np.nanargmin(error))
        assert colors[worst][0, 0] > colors[best][0, 0]
        unknown = colors[np.isnan(error)[faces]][:, :3]
        assert np.ptp(unknown, axis=0).max() == 0
        assert np.ptp(unknown[0]) < 0.05
