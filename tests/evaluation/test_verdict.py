"""One word about a label: monotone in what speaks against it, the worst label's for all."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.evaluation.label_evidence import LabelEvidence
from clothtrack.evaluation.label_quality import LabelQuality, Misplaced
from clothtrack.evaluation.verdict import (
    LIMITS,
    WORDS,
    Verdict,
    picture_verdict,
    trajectory_verdict,
)
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.agreement import Agreement
from clothtrack.reconstruction.from_picture import NetworkMesh, Reconstruction
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.recordings.geometry_checks.finding import Finding

ERROR = LIMITS["expected error"]
TRUSTED_MM, LARGEST_MM = 1e3 * ERROR.look, 1e3 * ERROR.reject
TORN = LIMITS["stretched edges"].look


def label(expected_mm, *, strain=0.01, action=0, **more):
    evidence = LabelEvidence(0.01, 0.001, 0.003, strain, 0.0, 0.001, 0.02, 0.4, action + 1)
    return LabelQuality(action, 10 * (action + 1), expected_mm, evidence, **more)


def verdict(one):
    return trajectory_verdict([one]).of_label(one.action)


def test_a_larger_expected_error_never_makes_a_better_word():
    errors = [0.5, 4.4, TRUSTED_MM, TRUSTED_MM + 0.1, LARGEST_MM, LARGEST_MM + 0.1, 300.0, math.nan]
    words = [verdict(label(error)).word for error in errors]
    assert words == sorted(words, key=WORDS.index)
    assert words == ["trust"] * 3 + ["look"] * 2 + ["reject"] * 3


def test_a_torn_mesh_with_the_right_outline_is_looked_at():
    assert verdict(label(4.0, strain=TORN)).word == "trust"
    found = verdict(label(4.0, strain=0.4))
    assert found.word == "look"
    assert "40 %" in found.reason


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
    assert found.of_label(0) == found  # what is wrong with the recording spoils each label
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
    assert str(found) == (
        "reject: expected error 20.0 mm (trusted up to 8, rejected above 16), after "
        "action 2 of 3; 1 more"
    )
    assert found.expected_error_m == pytest.approx(0.020)
    assert trajectory_verdict([label(3.0), label(math.nan, action=1)]).word == "reject"
    assert [found.of_label(one.action).word for one in labels] == ["trust", "reject", "look"]
    assert found.of_label(2).reason == "expected error 9.0 mm (trusted up to 8)"
    assert trajectory_verdict(labels[:1]) == verdict(labels[0])
    assert trajectory_verdict([]).word == "look"


def test_a_verdict_is_the_same_after_json():
    for labels in ([label(3.0)], [label(math.nan)], [label(9.0, idle_pickers=("tip",))], []):
        found = trajectory_verdict(labels)
        again = Verdict.from_dict(json.loads(json.dumps(found.as_dict(), allow_nan=False)))
        assert again.as_dict() == found.as_dict()
        assert str(again) == str(found)


def picture(*, iou=0.97, chamfer_m2=2e-5, share=0.01, confidence=0.9, turns=0.01, given=()):
    """The verdict of a mesh whose longer side is 0.4 m."""
    mesh = garment("towel", vertex_count=60, size_m=(0.4, 0.2))
    sure = np.full((2, 2), confidence, np.float32)
    nothing = SeenPoints(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    camera = Camera("top", 2, 2, 2.0, 2.0, 0.5, 0.5, np.eye(4))
    image = np.zeros((2, 2, 3), np.float32)
    made = Reconstruction(mesh, "template", camera, image, sure, nothing)
    result = NetworkMesh(
        mesh, made, expected_error_m=share and 0.4 * share, spread_over_turns=turns
    )
    return picture_verdict(result, Agreement(iou, chamfer_m2), given)


ADVICE = {
    frozenset(): "give the garment's --size or --template, or the cloth's --mask",
    frozenset({"mask"}): "give the garment's --size or --template",
    frozenset(
        {"size"}
    ): "give the garment's --template instead of its --size, or the cloth's --mask",
    frozenset({"size", "mask"}): "give the garment's --template instead of its --size",
    frozenset({"template"}): "give the cloth's --mask",
    frozenset({"template", "mask"}): "spread the cloth a little, and take another picture",
}
"""What helps against a wrong outline, by what was given."""


@pytest.mark.parametrize("given", ADVICE)
def test_what_was_given_is_never_advised(given):
    assert picture(iou=0.5, given=given).remedy == ADVICE[given]


MEASURES = {
    "silhouette": ("iou", lambda value: 1.0 - value),
    "visible surface over side": ("chamfer_m2", lambda value: 2.0 * (0.4 * value) ** 2),
    "spread over turns": ("turns", lambda value: value),
    "expected error over side": ("share", lambda value: value),
    "unsure correspondences": ("confidence", lambda value: 1.0 - value),
}


def test_the_mesh_of_one_picture_is_trusted_with_its_evidence():
    found = picture()
    assert str(found) == "trust: expected error 4.0 mm (trusted up to 24)"
    assert found.trusted_up_to_m == pytest.approx(0.024)
    assert found.remedy == ""
    assert {one.name for one in found.evidence} == set(MEASURES)


@pytest.mark.parametrize("name", MEASURES)
def test_every_measure_of_a_picture_decides_and_names_the_limit_that_it_broke(name):
    limit, (option, of) = LIMITS[name], MEASURES[name]
    factor = 1e3 if limit.unit == "m" else 100.0
    tried = [("trust", 0.98 * limit.look), ("look", 1.02 * limit.look)]
    if limit.reject < math.inf:
        tried += [("look", 0.98 * limit.reject), ("reject", 1.02 * limit.reject)]
    for word, value in tried:
        found = picture(**{option: of(value)})
        assert found.word == word
        if word != "trust":
            said = {"look": f"trusted up to {factor * limit.look:g}"}
            said |= {"reject": f"rejected above {factor * limit.reject:g}"}
            assert said[word] in found.reason
            assert found.remedy == (limit.remedy or ADVICE[frozenset()])


def test_a_mesh_that_nobody_can_see_or_vouch_for_is_not_trusted():
    found = picture(chamfer_m2=None)
    assert str(found).startswith("reject: no part of the mesh is visible in the picture")
    unknown = picture(share=None, turns=None)
    assert str(unknown) == (
        "look: the network does not say how far off it may be (errors trusted up to 24 mm)"
    )
    again = Verdict.from_dict(json.loads(json.dumps(unknown.as_dict(), allow_nan=False)))
    assert str(again) == str(unknown)
