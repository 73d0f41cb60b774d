"""Devices are checked by name before anything is computed."""

import subprocess
import sys

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.devices import require_device


@pytest.mark.parametrize("name", ["cuda:77", "gpu", ""])
def test_another_device_is_refused_with_those_that_are_there(name):
    with pytest.raises(InvalidConfigError, match="this machine has cpu"):
        require_device(name)


def test_the_streams_are_left_to_results_and_complaints():
    code = (
        "from clothtrack.geometry.devices import quiet_warp, require_device\n"
        "quiet_warp(); require_device('cpu')"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert shown.stdout == b""
    assert shown.stderr == b""
