"""Devices are checked by name before anything is computed."""

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.devices import require_device


@pytest.mark.parametrize("name", ["cuda:77", "gpu", ""])
def test_another_device_is_refused_with_those_that_are_there(name):
    with pytest.raises(InvalidConfigError, match="this machine has cpu"):
        require_device(name)
