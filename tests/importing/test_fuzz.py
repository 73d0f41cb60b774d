"""Damaged files of every format end as a recording or in our own error, and harm nothing beside."""

import shutil
from contextlib import suppress

import numpy as np
import pytest
from import_makers import (
    Film,
    Messages,
    lens_file,
    stream,
    write_folder,
    write_kinect,
    write_realsense_bag,
    write_realsense_db3,
    write_ros1,
    write_ros2,
)

from clothtrack.errors import ClothTrackError
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.import_recording import import_recording

FILM = Film(frames=3, width=16, height=12)
RAW = np.full((2, 288, 320), 700, np.uint16)
ROS1, ROS2 = Messages(cdr=False), Messages(cdr=True)
SOURCES = {
    "ros1": lambda path: write_ros1(path, stream(FILM, ROS1), ROS1),
    "ros1, lz4": lambda path: write_ros1(path, stream(FILM, ROS1), ROS1, compression="lz4"),
    "mcap": lambda path: write_ros2(path, stream(FILM, ROS2), ROS2),
    "sqlite": lambda path: write_ros2(path, stream(FILM, ROS2), ROS2, storage="sqlite3"),
    "realsense, old": lambda path: write_realsense_bag(path.with_suffix(".bag"), FILM),
    "realsense": lambda path: write_realsense_db3(path.with_suffix(".db3"), FILM, 0.01),
    "kinect": lambda path: write_kinect(path.with_suffix(".mkv"), RAW, None, [0, 33_333_333]),
    "tum": lambda path: write_folder(path, FILM, "tum"),
    "open3d": lambda path: write_folder(path, FILM, "open3d"),
    "bop": lambda path: write_folder(path, FILM, "bop"),
}


def damage(file, rng):
    """Cut a file off, or change some of its bytes."""
    data = bytearray(file.read_bytes())
    if rng.random() < 0.3:
        del data[rng.integers(len(data)) :]
    for place in rng.integers(max(len(data), 1), size=rng.integers(1, 6)):
        data[place : place + 1] = rng.bytes(1)
    file.write_bytes(data)


@pytest.mark.parametrize("kind", SOURCES)
def test_a_damaged_file_is_imported_or_refused(kind, tmp_path):
    whole, out = SOURCES[kind](tmp_path / "whole"), tmp_path / "out"
    source = tmp_path / f"source{whole.suffix}"
    lens = lens_file(tmp_path / "lens.json", FILM)
    chosen = {"tum": {"intrinsics": lens, "depth_unit_m": 0.001}, "bop": {"fps": 30.0}}
    options = ImportOptions(workers=1, **chosen.get(kind, {}))
    for number in range(20):
        rng = np.random.default_rng(number)
        (shutil.copytree if whole.is_dir() else shutil.copy)(whole, source)
        files = sorted(one for one in source.rglob("*") if one.is_file()) or [source]
        damage(files[rng.integers(len(files))], rng)
        before = {file: file.read_bytes() for file in files}
        with suppress(ClothTrackError):
            import_recording(source, out, options)
        assert {file: file.read_bytes() for file in files} == before
        for place in (source, out):
            shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
