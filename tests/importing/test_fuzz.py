"""Damaged files: our own error or a recording, in ten seconds and one gibibyte, nothing else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("fuzzing.py")
SOURCES = Path(__file__).parents[2] / "src"
FORMATS = (
    "ros1", "ros1-lz4", "mcap", "mcap-zstd", "sqlite", "realsense-bag", "realsense-db3", "kinect",
    "tum", "open3d", "bop",
)  # fmt: skip


def run(kinds, first, count, folder):
    environment = dict(os.environ, PYTHONPATH=str(SOURCES), OMP_NUM_THREADS="1")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), kinds, str(first), str(count), str(folder)],
        env=environment, capture_output=True, text=True, check=False, timeout=3000,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]


def test_forty_damaged_files_of_each_format(tmp_path):
    run(",".join(FORMATS), 0, 40, tmp_path / "place")


@pytest.mark.slow
@pytest.mark.parametrize("kind", FORMATS)
def test_two_thousand_damaged_files(kind, tmp_path):
    run(kind, 1000, 2000, tmp_path / "place")
