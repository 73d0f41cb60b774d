"""One word about a label: monotone in what speaks against it, the worst label's for all."""

import math

import pytest

from clothtrack.evaluation.label_evidence import LabelEvidence
from clothtrack.evaluation.label_quality import LabelQuality, shipped_model
from clothtrack.evaluation.verdict import (
    LARGEST_MM,
    TORN,
    TRUSTED_MM,
    WORDS,
    trajectory_verdict,
    verdict,
)


def label(expected_mm, *, strain=0.01, action=0):
    evidence = LabelEvidence(0.01, 0.001, 0.003, strain, 0.0, 0.001, 0.02, 0.4, action + 1)
    return LabelQuality(action, 10 * (action + 1), expected_mm, 0.5, evidence)


def test_a_larger_expected_error_never_makes_a_better_word():
    errors = [0.5, 4.4, TRUSTED_MM, TRUSTED_MM + 0.1, LARGEST_MM, LARGEST_MM + 0.1, 300.0, math.nan]
    words = [verdict(label(error)).word for error in errors]
    assert words == sorted(words, key=WORDS.index)
    assert words == ["trust"] * 3 + ["look"] * 2 + ["reject"] * 3


def test_the_verdict_says_the_expected_error_and_the_limit_that_decided():
    found = verdict(label(9.26))
    assert str(found) == "look: expected error 9.3 mm (trusted up to 8)"
    assert found.expected_error_m == pytest.approx(0.00926)
    assert "seen" in verdict(label(math.nan)).reason


def test_a_torn_mesh_with_the_right_outline_is_looked_at():
    assert verdict(label(4.0, strain=TORN)).word == "trust"
    found = verdict(label(4.0, strain=0.4))
    assert found.word == "look"
    assert "40 %" in found.reason


def test_a_typical_label_of_the_benchmark_is_trusted():
    assert verdict(label(1e3 * shipped_model().typical_error_m)).word == "trust"


def test_a_trajectory_is_worth_what_its_worst_label_is():
    labels = [label(3.0), label(20.0, action=1), label(9.0, action=2)]
    assert str(trajectory_verdict(labels)) == (
        "reject: expected error 20.0 mm (at most 16), after action 2 of 3"
    )
    assert trajectory_verdict([label(3.0), label(math.nan, action=1), label(99.0, action=2)]) == (
        trajectory_verdict([label(3.0), label(math.nan, action=1), label(17.0, action=2)])
    )
    assert trajectory_verdict(labels[:1]) == verdict(labels[0])
    assert trajectory_verdict([]).word == "look"
