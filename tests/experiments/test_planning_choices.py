"""A dozen actions of a start are carried out, and rules are compared on them."""

import json

import numpy as np
import pytest
from tables import planning_choices


@pytest.mark.slow
def test_one_start_is_measured_once(tmp_path, capsys):
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    assert planning_choices.main(["--smoke", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    (path,) = tmp_path.glob("*/row.json")
    row, written = json.loads(path.read_text()), path.stat().st_mtime_ns
    assert len(row["gain_m2"]) == len(row["done"]) == len(set(row["done"]))
    assert np.isfinite(row["gain_m2"]).all()
    beliefs = [*planning_choices.PERCEIVED, "truth", "either order"]
    assert list(row["promised_m2"]) == beliefs
    assert {len(gains) for gains in row["promised_m2"].values()} == {len(row["actions"])} == {12}
    off_m = np.array(row["off_m"])
    assert int(off_m.argmax()) in row["done"]
    for gains in row["promised_m2"].values():
        for strip_m in planning_choices.STRIPS_M:
            assert planning_choices.preferred(np.array(gains), off_m, strip_m) in row["done"]
    assert planning_choices.main(["--smoke", "--out", str(tmp_path)]) == 0
    assert path.stat().st_mtime_ns == written
    assert capsys.readouterr().out == printed


def starts(promise_worth, off_worth):
    """Starts whose gains are exactly so much of the promise and of the distance [m2, m2 per m]."""
    rng = np.random.default_rng(0)
    for base_m2 in (0.0, 0.01, -0.02):
        promised, off = rng.uniform(-0.01, 0.02, 12), rng.uniform(0.0, 0.2, 12)
        done = rng.permutation(12)
        gain = base_m2 + promise_worth * promised + off_worth * off
        yield {
            "gain_m2": gain[done].tolist(), "promised_m2": {"one": promised.tolist()},
            "off_m": off.tolist(), "done": done.tolist(),
        }  # fmt: skip


def test_a_strip_is_what_a_meter_is_worth_over_the_promise():
    line = planning_choices.fitted(list(starts(0.25, 0.02)), "one")
    assert line == "| 0.25 ± 0.00 | 200 ± 0 | 0.080 | 100 % |"


def test_the_right_strip_wins_most():
    rows = list(starts(1.0, 0.09))
    *others, best = (
        np.mean(planning_choices.won(rows, "one", strip_m)) for strip_m in planning_choices.STRIPS_M
    )
    assert max(others) < best
