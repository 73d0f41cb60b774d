"""The statistics of single experiments, on rows whose answer is known."""

from types import SimpleNamespace

import numpy as np
import pytest
from real import table2_real
from shared.table_column import mean_and_error, paired
from tables import calibration, planning_choices, reliability
from tables.crumpled_start import errors_mm
from tables.same_bits import compare, gaps

from clothtrack.evaluation.truth import Truth
from clothtrack.garments.garment_meshes import garment
from clothtrack.tracking.configuration import mode


def test_an_interval_is_the_standard_error_of_the_mean():
    values = np.array([-6.0, 2.0, 1.0])
    error = values.std(ddof=1) / 3**0.5
    assert paired(values) == [f"-1.0 ± {error:.1f}", "1 of 3"]
    assert mean_and_error(values[1:2], 2) == "2.00 ± -"


def chosen(**parameters):
    rows = [{"stage": stage, "parameters": parameters} for stage in ("before", "after")]
    return [*rows, {"error": "burst"}]


def test_the_most_frequent_value_of_each_parameter_wins():
    rows = [
        *chosen(table_friction=0.3, bend_compliance=1.0),
        *chosen(table_friction=1.0, bend_compliance=1.0),
        *chosen(table_friction=1.0, bend_compliance=100.0),
        *chosen(table_friction=0.3, bend_compliance=100.0),
        *chosen(table_friction=3.0, bend_compliance=100.0),
    ]
    assert calibration.most_frequent(rows) == {"table_friction": 0.3, "bend_compliance": 100.0}


def test_offline_parameters_are_not_searched_again():
    config = calibration.fixed(mode("default"), {"table_friction": 3.0})
    assert config.search.method == "none"
    assert config.cloth.table_friction == 3.0
    assert config.cloth.bend_compliance == mode("default").cloth.bend_compliance


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


def test_statistics_are_over_pictures_and_the_error_over_sequences():
    rows = [
        {"sequence": "a", "corner_mm": 1.0}, {"sequence": "a", "corner_mm": 3.0},
        {"sequence": "b", "corner_mm": 6.0}, {"sequence": "b"},
    ]  # fmt: skip
    found = table2_real._statistics("corner_mm", rows)
    assert found["corner_mm"] == pytest.approx(10 / 3)
    assert found["corner_mm_median"] == 3.0
    assert found["corner_mm_standard_error"] == pytest.approx(np.std([2, 6], ddof=1) / np.sqrt(2))


def test_errors_are_those_of_the_look_alike_that_fits_best():
    flat = garment("towel", vertex_count=120, size_m=(0.3, 0.2))
    positions = np.asarray(flat.vertices, np.float64)
    truth = Truth(positions[None], flat.faces, np.array([7]), np.asarray(flat.canonical, float))
    turned = positions * (-1.0, -1.0, 1.0) + (0.0, 0.0, 0.01)
    assert errors_mm(flat, [(7, turned)], truth) == pytest.approx([10.0])


def test_false_trust_and_false_alarm_are_told_from_right_verdicts():
    row = {"word": "trust", "mean_mm": 3.0, "p95_mm": 9.0}
    trust, alarm = reliability.false_trust, reliability.false_alarm
    assert not trust(row)
    assert trust({**row, "mean_mm": 8.5})
    assert trust({**row, "p95_mm": 31.0})
    assert not trust({**row, "word": "look", "mean_mm": 80.0})
    assert not alarm(row)
    assert alarm({**row, "word": "look"})
    assert not alarm({**row, "word": "look", "mean_mm": 6.0})
    assert alarm({"word": "refused"})
    assert not trust({"word": "refused"})


def test_the_error_of_a_verdict_is_that_of_the_truth(monkeypatch):
    """A shift of the truth shows in the error, millimeter by millimeter."""
    flat = garment("towel", vertex_count=120, size_m=(0.3, 0.2))
    at = np.asarray(flat.vertices, np.float64)
    verdict = SimpleNamespace(word="trust", reason="")
    run = SimpleNamespace(mesh=flat, labels=[], frames=[0], positions=[at], verdict=verdict)
    monkeypatch.setattr(reliability.ct, "track", lambda *_, **__: run)
    data = SimpleNamespace(
        truth=at[None] + (0.0, 0.0, 0.5), moments=np.zeros(1, int), truth_faces=flat.faces,
        truth_canonical=np.asarray(flat.canonical, np.float64),
    )  # fmt: skip
    assert reliability.compared(None, data)["mean_mm"] == pytest.approx(500.0)
