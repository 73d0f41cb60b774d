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


def test_the_held_vertex_leads_and_the_cloth_stays_whole(roll_outs):
    shard = read_roll_outs(roll_outs[0])
    rolls, frames, vertices, _ = shard.positions.shape
    assert rolls >= 2
    assert vertices == shard.mesh.vertex_count
    edges = shard.mesh.edges
    lengths = np.linalg.norm(np.diff(shard.positions[:, :, edges], axis=3)[..., 0, :], axis=-1)
    assert np.abs(lengths / shard.mesh.edge_lengths - 1.0).mean() < 0.25
    assert shard.positions[..., 2].min() > -0.002
    moved = 0
    for roll in range(rolls):
        until = shard.held_frames[roll]
        assert until < frames
        if shard.held[roll] < 0:
            continue
        way = np.linalg.norm(np.diff(shard.positions[roll, : until + 1], axis=0), axis=2).sum(0)
        assert way[shard.held[roll]] > 0.04
        moved += 1
    assert moved >= 2


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
