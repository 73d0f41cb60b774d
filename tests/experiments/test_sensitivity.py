"""Each axis changes its own setting and nothing else, and the default is one of its values."""

from pathlib import Path

import pytest
from shared.experiment import Setup
from tables import sensitivity
from tables.collision import weighted

from clothtrack.tracking import mode

DEFAULT_ON = ("rigidity", "thickness", "cloud", "first mesh")


@pytest.fixture
def setup():
    return Setup(Path("bench"), Path("out"))


@pytest.mark.parametrize("axis", [*DEFAULT_ON, "explosion", "vertices"])
def test_values_of_an_axis_are_different_runs(setup, axis):
    variants = sensitivity._variants(setup, mode("default"), axis)
    assert all(each.name.startswith(f"{axis}=") for each in variants)
    assert len({each.name for each in variants}) == len({each.digest for each in variants}) >= 4


@pytest.mark.parametrize("axis", DEFAULT_ON)
def test_the_default_is_on_the_axis_and_shares_its_run(setup, axis):
    variants = sensitivity._variants(setup, mode("default"), axis)
    assert setup.variant("default", "default").digest in {each.digest for each in variants}


def test_a_weight_goes_to_both_alignments():
    config = weighted(mode("default"), rigidity_weight=0.0)
    assert config.objective.rigidity_weight == 0.0
    assert config.objective.length_weight == mode("default").objective.length_weight
