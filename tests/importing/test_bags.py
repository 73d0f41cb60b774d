"""ROS 1 and ROS 2 bags: every bit of depth arrives, whatever the container."""

import re

import numpy as np
import pytest
from import_makers import (
    START_NS,
    Film,
    Messages,
    color_of,
    depth_of,
    png,
    stream,
    write_ros1,
    write_ros2,
)
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as OtherMcapWriter

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings.store import read_recording
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.import_recording import import_recording

ROS2 = Messages(cdr=True)
ROS1 = Messages(cdr=False)
WRITERS = {
    "mcap": lambda path, film: write_ros2(path, stream(film, ROS2), ROS2),
    "mcap zstd": lambda path, film: write_ros2(
        path, stream(film, ROS2), ROS2, compression="storage"
    ),
    "sqlite": lambda path, film: write_ros2(path, stream(film, ROS2), ROS2, storage="sqlite3"),
    "sqlite, each message zstd": lambda path, film: write_ros2(
        path, stream(film, ROS2), ROS2, storage="sqlite3", compression="message"
    ),
    "ros 1": lambda path, film: write_ros1(path, stream(film, ROS1), ROS1),
    "ros 1 bz2": lambda path, film: write_ros1(path, stream(film, ROS1), ROS1, compression="bz2"),
    "ros 1 lz4": lambda path, film: write_ros1(path, stream(film, ROS1), ROS1, compression="lz4"),
}


def as_lists(value):
    """A message as dictionaries and lists, which the other writer takes."""
    if hasattr(value, "__dataclass_fields__"):
        names = [name for name in value.__dataclass_fields__ if name != "__msgtype__"]
        return {name: as_lists(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    return value


def assert_same(recording, film, frames=slice(None)):
    assert np.array_equal(depth_of(recording), film.depth[frames])
    assert np.array_equal(color_of(recording), film.color[frames])


@pytest.mark.parametrize("kind", WRITERS)
def test_every_bit_arrives(kind, film, tmp_path):
    source = WRITERS[kind](tmp_path / "bag", film)
    report = import_recording(source, tmp_path / "out")
    assert_same(tmp_path / "out", film)
    recording = read_recording(tmp_path / "out")
    times = [frame.time_s for frame in recording.frames]
    assert np.allclose(times, (film.times - START_NS) / 1e9, atol=1e-9)
    camera = recording.cameras[0]
    assert (camera.fx, camera.cx, camera.cy) == (film.f, film.matrix[2], film.matrix[5])
    assert recording.depth_units_m == {"camera": 0.001}
    assert report.frames == film.frames
    assert "REP 118" in report.depth_unit_origin
    assert not report.dropped


@pytest.mark.parametrize("compression", list(CompressionType))
def test_mcap_of_another_writer(compression, film, tmp_path):
    """As `ros2 bag` and Foxglove write it: schemas with dependencies, CRCs, three packings."""
    definitions = {
        kind: ROS2.store.generate_msgdef(kind, ros_version=2)[0]
        for kind in ("sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo")
    }
    file = tmp_path / "film.mcap"
    with file.open("wb") as output:
        writer = OtherMcapWriter(output, chunk_size=5000, compression=compression)
        schemas = {kind: writer.register_msgdef(kind, text) for kind, text in definitions.items()}
        for topic, time, message in stream(film, ROS2):
            writer.write_message(
                topic, schemas[message.__msgtype__], as_lists(message), log_time=time,
                publish_time=time,
            )  # fmt: skip
        writer.finish()
    import_recording(file, tmp_path / "out")
    assert_same(tmp_path / "out", film)


@pytest.mark.parametrize("share", [0.45, 0.8])
@pytest.mark.parametrize("kind", ["mcap", "mcap zstd", "sqlite", "ros 1", "ros 1 lz4"])
def test_a_bag_that_breaks_off_is_refused_by_name(kind, share, tmp_path):
    source = WRITERS[kind](tmp_path / "bag", Film(frames=20, width=64, height=48))
    file = source if source.is_file() else next(source.glob("*.[dm][bc]*"))
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InvalidRecordingError, match=f"{re.escape(str(file))}: .*again"):
        import_recording(source, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_write_ahead_log_beside_a_bag_is_named(film, tmp_path):
    source = WRITERS["sqlite"](tmp_path / "bag", film)
    file = next(source.glob("*.db3"))
    file.with_name(file.name + "-wal").write_bytes(b"the last messages")
    with pytest.raises(InvalidRecordingError, match=f"{file.name}-wal; run sqlite3"):
        import_recording(source, tmp_path / "out")


def test_padding_byte_order_and_float_meters(tmp_path):
    film = Film(frames=3)
    lengths = film.depth / 1000.0
    lengths[0, 0, :4] = [np.nan, np.inf, -1.0, 7.0]
    entries = []
    for k, time in enumerate(film.times.tolist()):
        entries.append(("/depth/camera_info", time, ROS2.info(time, film)))
        image = ROS2.image(time, lengths[k].astype(">f4"), "32FC1", padding=5)
        image.is_bigendian = 1
        entries.append(("/depth/image_raw", time, image))
    source = write_ros2(tmp_path / "bag", entries, ROS2)
    report = import_recording(source, tmp_path / "out")
    expected = 10 * film.depth.astype(int)
    expected[0, 0, :4] = 0
    assert np.array_equal(depth_of(tmp_path / "out"), expected)
    assert report.depth_unit_m == pytest.approx(1e-4)
    assert "color" not in report.streams


def test_compressed_transports(film, tmp_path):
    entries = []
    for k, time in enumerate(film.times.tolist()):
        entries.append(("/camera/depth_registered/camera_info", time, ROS2.info(time, film)))
        entries.append(("/camera/rgb/camera_info", time, ROS2.info(time, film)))
        depth = ROS2.compressed(time, bytes(12) + png(film.depth[k]), "16UC1; compressedDepth")
        entries.append(("/camera/depth_registered/image_raw/compressedDepth", time, depth))
        color = ROS2.compressed(time, png(film.color[k]), "rgb8; png compressed bgr8")
        entries.append(("/camera/rgb/image_raw/compressed", time, color))
    source = write_ros2(tmp_path / "bag", entries, ROS2)
    import_recording(source, tmp_path / "out")
    assert_same(tmp_path / "out", film)


def test_topics_that_cannot_be_guessed_are_listed(film, tmp_path):
    entries = list(stream(film, ROS2, depth="/mine/tiefe", color="/mine/farbe"))
    source = write_ros2(tmp_path / "bag", entries, ROS2)
    with pytest.raises(InvalidRecordingError) as caught:
        import_recording(source, tmp_path / "out")
    for word in ("/mine/tiefe", "/mine/farbe", "--depth-topic"):
        assert word in str(caught.value)
    chosen = ImportOptions(depth_topic="/mine/tiefe", color_topic="/mine/farbe")
    import_recording(source, tmp_path / "out", chosen)
    assert_same(tmp_path / "out", film)
