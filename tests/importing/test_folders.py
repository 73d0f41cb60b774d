"""Folders of pictures in the styles of TUM, Open3D and BOP."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from import_makers import color_of, depth_of, lens_file, write_folder

from clothtrack.errors import ClothTrackError, InvalidRecordingError
from clothtrack.recordings.store import read_recording
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.import_recording import import_recording


def options(style, film, tmp_path):
    if style == "tum":
        lens = lens_file(tmp_path / "lens.json", film)
        return ImportOptions(intrinsics=lens, depth_unit_m=0.0002)
    return ImportOptions(fps=30.0 if style == "bop" else None)


@pytest.mark.parametrize(("style", "unit_m"), [("tum", 2e-4), ("open3d", 1e-3), ("bop", 1e-4)])
def test_every_bit_arrives(style, unit_m, film, tmp_path):
    if unit_m < 1e-3:
        film.depth *= 5  # so that the median is some decimeters in each unit
    source = write_folder(tmp_path / "film", film, style)
    report = import_recording(source, tmp_path / "out", options(style, film, tmp_path))
    assert np.array_equal(depth_of(tmp_path / "out"), film.depth)
    assert np.array_equal(color_of(tmp_path / "out"), film.color)
    assert report.depth_unit_m == pytest.approx(unit_m)
    recording = read_recording(tmp_path / "out")
    times = [frame.time_s for frame in recording.frames]
    assert np.allclose(times, np.arange(film.frames) / 30.0, atol=1e-6)
    assert recording.cameras[0].fx == film.f


def test_depth_as_jpeg_is_called_so(film, tmp_path):
    source = write_folder(tmp_path / "film", film, "open3d")
    for file in (source / "depth").iterdir():
        cv2.imwrite(str(file.with_suffix(".jpg")), (cv2.imread(str(file), -1) // 256).astype("u1"))
        file.unlink()
    with pytest.raises(InvalidRecordingError, match=r"depth as a JPEG.*16-bit gray PNG"):
        import_recording(source, tmp_path / "out")


def test_lists_and_links_do_not_lead_out(film, tmp_path):
    source = write_folder(tmp_path / "film", film, "tum")
    secret = tmp_path / "secret.png"
    (source / "depth").joinpath(next((source / "depth").iterdir()).name).rename(secret)
    with (source / "depth.txt").open("a") as lines:
        lines.write("1700000009.0 ../secret.png\n")
    report = import_recording(source, tmp_path / "out", options("tum", film, tmp_path))
    assert report.frames == film.frames - 1
    assert any("left out" in note for note in report.notes)


def test_a_bomb_costs_nothing(film, tmp_path):
    """A PNG that announces a gigantic picture is refused by its header."""
    source = write_folder(tmp_path / "film", film, "open3d")
    plain = (source / "depth" / "000001.png").read_bytes()
    head = b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 16, 0, 0, 0, 0)
    bomb = plain[:12] + head + struct.pack(">I", zlib.crc32(head)) + plain[33:]
    (source / "depth" / "000001.png").write_bytes(bomb)
    report = import_recording(source, tmp_path / "out")
    assert report.frames == film.frames - 1
    assert any("60000 x 60000" in one for one in report.dropped)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("{", "JSON"),
        ("[]", "object"),
        ('{"width": 32}', "height"),
        (
            '{"width": 32, "height": 24, "fx": -1, "fy": 1, "cx": 0, "cy": 0}',
            "-1; it must be above 0",
        ),
        ('{"width": 32, "height": 24, "fx": 1, "fy": 1, "cx": 0, "cy": 0, "distortion": [1]}', "1"),
        ('{"width": 1e9, "height": 24, "fx": 1, "fy": 1, "cx": 0, "cy": 0}', "whole"),
    ],
)
def test_a_wrong_lens_file_is_named(content, word, film, tmp_path):
    source = write_folder(tmp_path / "film", film, "open3d")
    (source / "intrinsic.json").write_text(content)
    with pytest.raises(ClothTrackError, match=word) as caught:
        import_recording(source, tmp_path / "out")
    assert "intrinsic.json" in str(caught.value)


def test_what_a_folder_does_not_say_is_asked_for_at_once(film, tmp_path):
    lens = lens_file(tmp_path / "lens.json", film)
    folders = {style: write_folder(tmp_path / style, film, style) for style in ("tum", "bop")}
    bare = write_folder(tmp_path / "bare", film, "bop")
    (bare / "scene_camera.json").unlink()
    for source, chosen, flags in (
        (folders["tum"], ImportOptions(intrinsics=lens), ["--depth-unit-m"]),
        (folders["tum"], ImportOptions(depth_unit_m=0.001), ["--intrinsics"]),
        (folders["bop"], ImportOptions(), ["--fps"]),
        (bare, ImportOptions(), ["--fps", "--intrinsics FILE", "--depth-unit-m"]),
    ):
        with pytest.raises(InvalidRecordingError) as refused:
            import_recording(source, tmp_path / "out", chosen)
        assert all(flag in str(refused.value) for flag in flags)
