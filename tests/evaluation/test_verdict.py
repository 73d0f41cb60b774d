"""One word about a label: monotone in what speaks against it, the worst label's for all."""

import json
import math
from dataclasses import replace

import pytest

from clothtrack.evaluation.label_evidence import LabelEvidence
from clothtrack.evaluation.label_quality import LabelQuality, Misplaced, shipped_model
from clothtrack.evaluation.verdict import (
    LIMITS,
    WORDS,
    Verdict,
    reconstruction_verdict,
    trajectory_verdict,
    verdict,
)
from clothtrack.recordings.geometry_checks.finding import Finding

ERROR = LIMITS["expected error"]
TRUSTED_MM, LARGEST_MM = 1e3 * ERROR.look, 1e3 * ERROR.reject
TORN = LIMITS["stretched edges"].look


def label(expected_mm, *, strain=0.01, action=0, **more):
    evidence = LabelEvidence(0.01, 0.001, 0.003, strain, 0.0, 0.001, 0.02, 0.4, action + 1)
    return LabelQuality(action, 10 * (action + 1), expected_mm, 0.5, evidence, **more)


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


def test_a_lost_flap_under_a_small_mean_is_looked_at_and_named():
    flap = Misplaced(0.15, 0.02, "at the right")
    found = verdict(label(2.5, misplaced=flap))
    assert found.word == "look"
    assert "the cloth at the right, 15 % of it, may be 20 mm off" in found.reason
    assert verdict(label(2.5, misplaced=replace(flap, share=0.7))).word == "reject"


def test_a_picker_that_holds_nothing_is_no_reason_to_trust():
    found = verdict(label(2.5, idle_pickers=("tip",)))
    assert found.word == "look"
    assert "picker tip holds no cloth" in found.reason


def test_what_the_recording_contradicts_itself_in_is_heard():
    doubt = Finding("picker_clock", 0.4, 0.1, "s", "picker.csv", "the picker is 0.4 s late")
    found = trajectory_verdict([label(2.5)], [doubt])
    assert found.word == "look"
    assert "the picker is 0.4 s late" in found.reason
    assert found.evidence[0].name == "picker_clock"
    assert found.remedy
    assert trajectory_verdict([label(2.5)]).remedy == ""


def test_cloth_that_moves_after_an_action_leaves_the_mesh_behind():
    flap = Misplaced(0.12, 0.06, "at the left")
    found = trajectory_verdict([label(2.5)], later=[(40, Misplaced()), (60, flap)])
    assert found.word == "look"
    assert "the cloth at the left, 12 % of it, may be 60 mm off, by frame 60" in found.reason
    assert "actions" in found.remedy
    assert trajectory_verdict([label(2.5)], later=[(40, Misplaced())]).word == "trust"


def test_a_trajectory_is_worth_what_its_worst_label_is():
    labels = [label(3.0), label(20.0, action=1), label(9.0, action=2)]
    found = trajectory_verdict(labels)
    assert str(found) == "reject: expected error 20.0 mm (at most 16), after action 2 of 3; 1 more"
    assert found.expected_error_m == pytest.approx(0.020)
    assert trajectory_verdict([label(3.0), label(math.nan, action=1)]).word == "reject"
    assert trajectory_verdict(labels[:1]) == verdict(labels[0])
    assert trajectory_verdict([]).word == "look"


def test_a_verdict_is_the_same_after_json():
    for labels in ([label(3.0)], [label(math.nan)], [label(9.0, idle_pickers=("tip",))], []):
        found = trajectory_verdict(labels)
        again = Verdict.from_dict(json.loads(json.dumps(found.as_dict(), allow_nan=False)))
        assert again.as_dict() == found.as_dict()
        assert str(again) == str(found)


def test_the_mesh_of_one_picture_has_the_limits_of_a_label():
    assert reconstruction_verdict("", 1e-3 * TRUSTED_MM).word == "trust"
    assert reconstruction_verdict("", 0.023).word == "reject"
    found = reconstruction_verdict("it covers what was seen to 0.50 only", None)
    assert str(found) == "look: it covers what was seen to 0.50 only"
    assert found.remedy
    assert reconstruction_verdict("", None).word == "trust"
