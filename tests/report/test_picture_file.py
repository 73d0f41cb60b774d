"""A picture is written whole, or a full disk is told in our own words."""

import resource

import cv2
import numpy as np
import pytest

from clothtrack.errors import StorageError
from clothtrack.report.video import write_picture


def test_what_is_written_is_what_was_drawn(tmp_path, rng):
    picture = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    write_picture(tmp_path / "sheet.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "sheet.png"))[..., ::-1], picture)


def test_a_full_disk_is_one_error_and_nothing_said_besides(tmp_path, rng, capfd):
    picture = rng.integers(0, 256, (200, 300, 3), dtype=np.uint8)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(StorageError, match=r"sheet.* free some space"):
            write_picture(tmp_path / "sheet.png", picture)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""
