"""Cloth that slips is left behind, and the recording does not say so."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.recordings.store import read_recording
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.filming import simulate


@pytest.mark.slow
def test_cloth_slips_out_of_the_gripper_and_the_path_says_nothing(tmp_path):
    paths, truths = [], []
    for slips in (0.0, 1.0):
        out = tmp_path / str(slips)
        (folder,) = simulate(out, "towel", 1, config=replace(SMALL_WORLD, slips=slips))
        (path,) = read_recording(folder).picker_paths.values()
        paths.append(path)
        truths.append(np.load(out / "truth" / "towel_0000.npz"))
    assert [one["slipped"].tolist() for one in truths] == [[False], [True]]
    carried = min(len(path.closed) for path in paths)
    closed = [path.closed[:carried] for path in paths]
    np.testing.assert_array_equal(*closed)
    gap = np.abs(truths[0]["positions"][:carried] - truths[1]["positions"][:carried])
    assert gap[0].max() == 0.0
    assert gap[-1].max() > 0.005
