"""Decisions about labels: kept beside the trajectory, tied to the meshes that were looked at."""

import json
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_review import LabelReview, read_review, review_path
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

LABEL = {"action": 0, "frame": 1, "mesh": "0" * 16, "verdict": "open"}
WHOLE = {
    "format": "clothtrack-label-review", "version": 1, "trajectory": "towel", "labels": [LABEL]
}  # fmt: skip

MESH = ClothMesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [1, 3, 2]])
)


@pytest.fixture
def tracked():
    none = Calibration("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)
    actions = tuple(
        TrackedAction(
            n, n + 1, MESH.vertices + n, MESH.vertices + n + 0.5, np.zeros(2), {}, none, {}
        )
        for n in range(3)
    )
    return TrackedTrajectory(
        name="towel",
        mesh=MESH,
        frames=np.arange(4),
        time_s=np.arange(4) / 10,
        positions=np.zeros((4, 4, 3), np.float32),
        visible=np.ones((4, 4), bool),
        actions=actions,
        steps=StepRecords.empty(4),
    )


def test_decisions_come_back_and_can_be_changed(tracked, tmp_path):
    path = tmp_path / "towel.review.json"
    assert review_path(tmp_path / "towel.zarr") == path
    blank = LabelReview.blank(tracked)
    assert read_review(path, tracked) == blank
    assert [one.verdict for one in blank.labels] == ["open"] * 3
    review = blank.decided(0, "accepted").decided(2, "rejected")
    review.save(path)
    found = read_review(path, tracked)
    assert found == review
    assert found.rejected == {2}
    assert found.decided(2, "open").rejected == frozenset()
    assert [file.name for file in tmp_path.iterdir()] == ["towel.review.json"]


def test_a_trajectory_stored_and_loaded_is_the_one_that_was_reviewed(tracked, tmp_path):
    """The meshes are stored as float32, so that is what they are known by."""
    tracked.save(tmp_path / "towel.zarr")
    LabelReview.blank(tracked).decided(1, "rejected").save(tmp_path / "towel.review.json")
    stored = TrackedTrajectory.load(tmp_path / "towel.zarr")
    assert read_review(tmp_path / "towel.review.json", stored).rejected == {1}


def test_decisions_about_other_meshes_are_refused(tracked, tmp_path):
    path = tmp_path / "towel.review.json"
    LabelReview.blank(tracked).decided(1, "rejected").save(path)
    moved = tracked.actions[1].positions_after_final_alignment + 1e-4
    again = replace(tracked.actions[1], positions_after_final_alignment=moved)
    other = replace(tracked, actions=(tracked.actions[0], again, tracked.actions[2]))
    for one in (other, replace(tracked, name="shirt"), replace(tracked, actions=())):
        with pytest.raises(InvalidResultError, match="other meshes"):
            read_review(path, one)


@pytest.mark.parametrize(
    "content",
    [
        json.dumps({**WHOLE, "version": 2}),
        json.dumps({**WHOLE, "format": "clothtrack-pseudo-labels"}),
        json.dumps({**WHOLE, "labels": [{**LABEL, "verdict": "maybe"}]}),
        json.dumps({**WHOLE, "labels": [{**LABEL, "verdict": []}]}),
        json.dumps({**WHOLE, "labels": 3}),
        json.dumps([WHOLE]),
        json.dumps(WHOLE)[:60],
        "",
        "[" * 100_000,
    ],
    ids=lambda content: content[:60],
)
def test_damaged_reviews_are_refused_with_the_remedy(tracked, tmp_path, content):
    path = tmp_path / "towel.review.json"
    path.write_text(content)
    with pytest.raises(InvalidResultError, match="review the labels again"):
        read_review(path, tracked)
