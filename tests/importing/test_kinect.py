"""Azure Kinect recordings: the container against libav, the calibration against a projection."""

import json
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from import_makers import depth_of, kinect_calibration, write_kinect

from clothtrack_capture.importing.import_recording import import_recording
from clothtrack_capture.importing.kinect import Matroska, kinect_intrinsics

TIMES = np.array([0, 33_333_000, 66_666_000])
FILM = Path("film.mkv")
NARROW, HD = (320, 288), (1280, 720)


@pytest.fixture
def depth(rng):
    counts = rng.integers(400, 3000, (3, 288, 320)).astype(np.uint16)
    counts[:, :20] = 0
    return counts


@pytest.fixture
def color(rng):
    small = rng.integers(0, 256, (3, 45, 80, 3), dtype=np.uint8)
    return np.stack([cv2.resize(one, HD, interpolation=cv2.INTER_CUBIC) for one in small])


def text():
    return json.dumps(kinect_calibration()).encode()


def test_what_a_file_holds_is_read(depth, color, tmp_path):
    source = write_kinect(tmp_path / "film.mkv", depth, color, TIMES)
    film = Matroska(source)
    assert [track.name for track in film.tracks] == ["COLOR", "DEPTH"]
    for frames in (film.frames[0], film.frames[1]):
        assert [frame.time_ns for frame in frames] == (TIMES // 1000 * 1000).tolist()
    for frame, counts in zip(film.frames[1], depth, strict=True):
        assert film.fetch(frame) == counts.astype(">u2").tobytes()
    assert film.attachments == {"calibration.json": text()}
    assert film.tags["K4A_DEPTH_MODE"] == "NFOV_2X2BINNED"
    assert not film.damage
    film.close()


def test_every_file_that_was_cut_off_says_so(depth, color, tmp_path):
    whole = write_kinect(tmp_path / "film.mkv", depth, color, TIMES).read_bytes()
    for name in ("one.mkv", "two.mkv"):
        (tmp_path / name).write_bytes(whole[: int(0.9 * len(whole))])
        film = Matroska(tmp_path / name)
        assert film.damage
        film.close()


def test_a_file_of_another_writer_is_read(color, tmp_path):
    path = tmp_path / "film.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = *HD, "yuvj420p"
        for picture in color:
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with av.open(str(path)) as container:
        packets = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    film = Matroska(path)
    assert [film.fetch(frame) for frame in film.frames[0]] == packets
    assert film.tracks[0].letters == "MJPG"
    film.close()


def test_depth_alone_arrives_where_its_lens_is_straight(depth, tmp_path):
    """Without distortion every bit stays; big-endian on disk."""
    calibration = kinect_calibration()
    lens = calibration["CalibrationInformation"]["Cameras"][0]["Intrinsics"]["ModelParameters"]
    lens[4:] = [0.0] * 10
    source = write_kinect(tmp_path / "film.mkv", depth, None, TIMES, calibration=calibration)
    report = import_recording(source, tmp_path / "out")
    assert np.array_equal(depth_of(tmp_path / "out"), depth)
    assert report.duration_s == pytest.approx(0.066666)
    assert report.depth_unit_m == 0.001


@pytest.mark.parametrize("letters", [b"MJPG", b"BGRA"])
def test_depth_is_carried_to_the_color_camera(letters, depth, color, tmp_path):
    depth[:] = 1000
    source = write_kinect(tmp_path / "film.mkv", depth, color, TIMES, letters=letters)
    report = import_recording(source, tmp_path / "out")
    assert "carried" in report.registration
    carried = depth_of(tmp_path / "out")[0]
    assert carried.shape == HD[::-1]
    inner = carried[200:500, 400:880]
    assert (inner > 0).all()
    # A plane at 1 m before the depth camera, seen from one that is tilted by six degrees.
    assert 900 < inner.min() < inner.max() < 1100


def test_lenses_against_the_formula():
    """Sensor shares, outer corner at zero -> pixels of the mode, first center at zero."""
    depth, color, pose = kinect_intrinsics(FILM, text(), NARROW, HD)
    assert depth.fx == pytest.approx(0.49 * 512)
    assert depth.cx == pytest.approx(0.5 * 512 - 96 - 0.5)
    assert depth.cy == pytest.approx(0.5 * 512 - 90 - 0.5)
    assert color.fy == pytest.approx(0.64 * 960)
    assert color.cy == pytest.approx(0.5 * 960 - 120 - 0.5)
    assert depth.distortion[2:4] == (-5e-5, 1e-4)  # the file has p2 before p1
    assert pose[:3, 3] == pytest.approx([-0.032, -0.002, 0.004])


def test_binning_changes_the_pixels_not_the_rays():
    """Modes of the same crop see the same directions at the same places."""
    coarse, fine = (kinect_intrinsics(FILM, text(), mode, None)[0] for mode in (NARROW, (640, 576)))
    rays, finer = coarse.corner_rays(), fine.corner_rays()[::2, ::2]
    assert np.allclose(rays, finer, atol=1e-4, equal_nan=True)


def test_what_breaks_off_is_saved(depth, tmp_path):
    source = write_kinect(tmp_path / "film.mkv", depth, None, TIMES)
    data = source.read_bytes()
    source.write_bytes(data[:-100_000])
    report = import_recording(source, tmp_path / "out")
    assert report.frames == 2
    assert any("2 whole pictures" in note for note in report.notes)
