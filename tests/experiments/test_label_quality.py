"""Label quality is fitted on dev alone, and what it says of test does not depend on test."""

from dataclasses import replace

import numpy as np
import pytest
from shared.bench_runs import read_rows
from tables import label_quality
from tables.label_quality import Judged, cross_validated

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation import LabelEvidence, QualityModel

STAMP = {"commit": "abc", "config_hash": "def"}


def judged(split, count=8, *, noise=0.0, seed=0):
    """Labels whose errors follow from the silhouette, but for some noise."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        for action in (1, 2, 3):
            gap = float(rng.uniform(0.01, 0.2))
            error = 60.0 * gap * float(np.exp(noise * rng.normal()))
            evidence = LabelEvidence(gap, 1e-3, 4e-3, 0.01, 0.0, 1e-3, 0.02, 0.3, action)
            row = {
                "variant": "default", "recording": f"{split}_{number}", "split": split,
                "kind": ("towel", "tshirt")[number % 2], "action": action, "frame": 30 * action,
                "run": f"runs/{split}_{number}/x.jsonl", "error_all_mm": error,
                "provenance": STAMP,
            }  # fmt: skip
            found.append(Judged(row, evidence))
    return found


def test_a_trajectory_is_judged_by_the_others():
    labels = judged("dev", 20)
    evidence = [one.evidence for one in labels]
    names = [one.row["recording"] for one in labels]
    errors = np.array([one.row["error_all_mm"] for one in labels])
    expected = cross_validated(evidence, errors, names)
    lied = errors.copy()
    lied[:3] *= 50.0
    again = cross_validated(evidence, lied, names)
    assert again[:3] == pytest.approx(expected[:3], rel=1e-6)
    assert not np.allclose(again[3:], expected[3:], rtol=1e-3)


def test_the_model_sees_no_label_but_those_of_dev():
    dev, test = judged("dev"), judged("test", seed=1)
    alone = label_quality.fitted(dev, "default")
    lied = [replace(one, row=one.row | {"error_all_mm": 1.0}) for one in test]
    assert label_quality.fitted([*dev, *lied], "default") == alone
    assert alone.provenance["labels"] == 24
    assert alone.provenance["trajectories"] == 8
    assert alone.provenance["commits"] == ["abc"]
    assert alone.provenance["rank_correlation_cross_validated"] > 0.95
    with pytest.raises(InvalidConfigError, match="--split dev"):
        label_quality.fitted(test, "default")


def test_the_table_tells_a_relation_from_none():
    report, untold = judged("test"), judged("test", noise=4.0, seed=2)
    model = label_quality.fitted([*judged("dev", seed=3)], "default")
    for labels, low, high in ((report, 0.95, 1.0), (untold, -0.6, 0.6)):
        ((own, expected),) = label_quality.expectations(labels, model).values()
        rank = label_quality.rank_correlation(expected, [one.error_m for one in own])
        assert low <= rank <= high
    text = label_quality.scores(label_quality.expectations(report, model))
    assert "| test | 24 | 1.00 | 1.00 | 1.00 |" in text


def test_dev_is_judged_by_other_trajectories():
    dev = judged("dev")
    model = label_quality.fitted(dev, "default")
    ((_, expected),) = label_quality.expectations(dev, model).values()
    seen = [model.expected_error_m(one.evidence) for one in dev]
    assert expected == pytest.approx(seen, rel=0.2)
    assert not np.allclose(expected, seen, rtol=1e-6)


def test_correlation_needs_spread_and_leaves_out_what_is_unknown():
    assert label_quality.rank_correlation([1, 2, 3, 4, np.nan], [2, 4, 6, 9, 1]) == 1.0
    assert label_quality.rank_correlation([1, 2, 3, 4], [4, 3, 2, 1]) == -1.0
    assert np.isnan(label_quality.rank_correlation([1, 1, 1, 1], [4, 3, 2, 1]))
    assert np.isnan(label_quality.rank_correlation([1, 2], [1, 2]))


def test_the_command_fits_writes_and_prints(monkeypatch, tmp_path, capsys):
    labels = [*judged("dev"), *judged("test", noise=0.3, seed=5)]
    monkeypatch.setattr(label_quality, "judged_labels", lambda *_: labels)
    model = tmp_path / "model.json"
    arguments = ["--bench", str(tmp_path), "--rows", str(tmp_path), "--model", str(model)]
    assert label_quality.main(arguments) == 1
    assert "is not a label quality model" in capsys.readouterr().err
    assert label_quality.main([*arguments, "--fit"]) == 0
    assert QualityModel.load(model).weights["silhouette_gap"] > 0.0
    printed = capsys.readouterr().out
    assert "| dev, cross-validated | 24 |" in printed
    assert "| silhouette_gap | +1.00 | +1.00 | +1.00 |" in printed
    rows = read_rows(tmp_path / "label_quality.jsonl")
    assert len(rows) == 48
    assert {row["cross_validated"] for row in rows if row["split"] == "dev"} == {True}
    assert all(row["expected_error_mm"] > 0 for row in rows)
