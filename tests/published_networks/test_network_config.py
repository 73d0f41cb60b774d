from dataclasses import replace

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack_lab.published_networks.network_config import preset


def test_an_unknown_preset_is_refused():
    with pytest.raises(InvalidConfigError, match="choose one of small"):
        preset("huge")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("bins", 0),
        ("volume", 30),
        ("image_size", 129),
        ("widths", ()),
        ("widths", (32, 10**9)),
        ("volume", 1 << 20),
        ("grid", True),
        ("trim", float("nan")),
    ],
)
def test_what_no_network_has_is_refused(field, value):
    with pytest.raises(InvalidConfigError, match=f"NetworkConfig.{field}"):
        replace(preset("small"), **{field: value})
