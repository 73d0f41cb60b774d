"""Label quality is fitted on dev alone, and what it says of test does not depend on test."""

from dataclasses import replace

import numpy as np
import pytest
from tables import label_quality
from tables.label_quality import Judged, cross_validated

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.label_evidence import LabelEvidence

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


def test_correlation_needs_spread_and_leaves_out_what_is_unknown():
    assert label_quality.rank_correlation([1, 2, 3, 4, np.nan], [2, 4, 6, 9, 1]) == 1.0
    assert label_quality.rank_correlation([1, 2, 3, 4], [4, 3, 2, 1]) == -1.0
    assert np.isnan(label_quality.rank_correlation([1, 1, 1, 1], [4, 3, 2, 1]))
    assert np.isnan(label_quality.rank_correlation([1, 2], [1, 2]))
