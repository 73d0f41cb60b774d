"""Roll-outs: what is held goes where it is taken, and a shard depends on seed and number alone."""

import json

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack_lab.graph_dynamics.roll_outs import (
    RollOutConfig,
    generate_roll_outs,
    make_roll_outs,
    read_roll_outs,
)


def test_a_shard_depends_on_seed_and_number_alone(roll_outs, small_roll_outs):
    folder = roll_outs[0].parents[1]
    config = RollOutConfig()
    asked = json.loads((folder / "roll_outs.json").read_text())
    assert asked["kind"] == "towel"
    with pytest.raises(InvalidConfigError, match="another config"):
        generate_roll_outs(folder, "towel", 1, config=config)
    with pytest.raises(InvalidConfigError, match="another seed"):
        generate_roll_outs(folder, "towel", 1, seed=3, config=small_roll_outs)
    before = roll_outs[1].read_bytes()
    roll_outs[1].unlink()
    generate_roll_outs(folder, "towel", 12, config=small_roll_outs)
    again = read_roll_outs(roll_outs[1])
    assert roll_outs[1].read_bytes() == before
    other = make_roll_outs("towel", 2, 0, small_roll_outs)
    assert other.positions.shape[2] == read_roll_outs(roll_outs[2]).positions.shape[2]
    assert not np.array_equal(other.positions, again.positions)
