"""Damaged files: our own error or a recording, in ten seconds and one gibibyte, nothing else."""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).with_name("fuzzing.py")
SOURCES = Path(__file__).parents[2] / "src"


def test_damaged_files_of_each_format(tmp_path):
    environment = dict(os.environ, PYTHONPATH=str(SOURCES), OMP_NUM_THREADS="1")
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "0", "20", str(tmp_path / "place")],
        env=environment, capture_output=True, text=True, check=False, timeout=3000,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
