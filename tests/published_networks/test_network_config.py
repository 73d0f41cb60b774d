from dataclasses import replace

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack_lab.published_networks.network_config import PRESETS, preset


def test_presets_have_the_published_and_the_small_sizes():
    assert (preset("reference").image_size, preset("reference").grid) == (200, 128)
    assert (preset("small").image_size, preset("small").volume) == (128, 32)
    assert set(PRESETS) == {"small", "reference"}


def test_an_unknown_preset_is_refused():
    with pytest.raises(InvalidConfigError, match="small, reference"):
        preset("huge")


@pytest.mark.parametrize(
    ("field", "value"),
    [("bins", 0), ("encoder", "vit"), ("output_stride", 3), ("volume", 30), ("image_size", 0)],
)
def test_sizes_that_cannot_be_built_are_refused(field, value):
    with pytest.raises(InvalidConfigError, match=f"NetworkConfig.({field}|image_size)"):
        replace(preset("small"), **{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [
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


def test_an_hrnet_has_four_resolutions():
    with pytest.raises(InvalidConfigError, match="4 resolutions"):
        replace(preset("reference"), widths=(32, 64, 128))
