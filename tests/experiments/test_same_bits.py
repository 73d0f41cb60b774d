"""What `same_bits` calls equal, on small arrays."""

import numpy as np
from tables.same_bits import compare, gaps


def test_a_bit_is_a_difference_unless_a_limit_allows_it():
    one, other = {"x": np.array([1.0, np.nan])}, {"x": np.array([1.0 + 1e-6, np.nan])}
    assert gaps(one, one, 0.0) == []
    assert gaps(one, other, 1e-5) == []
    assert gaps(one, other, 0.0) == [("x", "largest difference 1.0e-06")]
    assert gaps(one, {"x": np.array([1.0, 2.0])}, 1e-5)[0][0] == "x"
    assert gaps(one, {"x": np.ones(3)}, 1e-5) == [("x", "shape (2,) became (3,)")]
    assert gaps(one, {}, 1e-5) == [("x", "is only in one")]


def test_every_changed_word_is_told(tmp_path, capsys):
    for side, word in (("base", "trust"), ("after", "look")):
        (tmp_path / side).mkdir()
        words = np.array([f"verdict: {word}", "stretched edges: look"])
        np.savez(tmp_path / side / "track.npz", cpu_s=1.0, words=words)
        (tmp_path / side / "items.json").write_text('["track"]')
    assert compare(tmp_path / "base", tmp_path / "after") == 1
    told = capsys.readouterr().out
    assert "- verdict: trust" in told
    assert "+ verdict: look" in told
    assert "stretched" not in told
    assert compare(tmp_path / "base", tmp_path / "base") == 0
