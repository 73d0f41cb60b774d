"""Decisions about labels: kept beside the trajectory, tied to the meshes that were looked at."""

import json
from dataclasses import replace
from pathlib import Path

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


def test_the_review_lies_beside_its_trajectory():
    assert review_path(Path("out/towel.zarr")) == Path("out/towel.review.json")
    assert review_path(Path("out/v1.2.zarr")) == Path("out/v1.2.review.json")


def test_without_a_file_everything_is_open(tracked, tmp_path):
    review = read_review(tmp_path / "none.review.json", tracked)
    assert [one.verdict for one in review.labels] == ["open"] * 3
    assert review.rejected == frozenset()


def test_decisions_come_back_and_can_be_changed(tracked, tmp_path):
    path = tmp_path / "towel.review.json"
    review = LabelReview.blank(tracked).decided(0, "accepted").decided(2, "rejected")
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


def damaged(document):
    """Damages that a disk, an editor or another version may do."""
    labels = document["labels"]
    yield "version", {**document, "version": 2}
    yield "format", {**document, "format": "clothtrack-pseudo-labels"}
    yield "verdict", {**document, "labels": [{**one, "verdict": "maybe"} for one in labels]}
    yield "no verdict", {**document, "labels": [{"action": 0, "frame": 1, "mesh": ""}]}
    yield "labels are a number", {**document, "labels": 3}
    yield "a key is a list", {**document, "labels": [{**labels[0], "frame": []}]}
    yield "verdict is a list", {**document, "labels": [{**labels[0], "verdict": []}]}
    yield "no name", {key: value for key, value in document.items() if key != "trajectory"}
    yield "a list", [document]
    yield "nothing", None


WHOLE = json.dumps(
    {
        "format": "clothtrack-label-review",
        "version": 1,
        "trajectory": "towel",
        "labels": [{"action": 0, "frame": 1, "mesh": "0" * 16, "verdict": "open"}],
    }
).encode()


@pytest.mark.parametrize(
    "content",
    [
        *(json.dumps(wrong).encode() for wrong in damaged(json.loads(WHOLE))),
        *(WHOLE[:length] for length in range(0, len(WHOLE), 29)),
        b"\xff\xfe\x00",
        b"[" * 100_000,
    ],
    ids=lambda content: content[:24].decode("latin-1") + f" ({len(content)})",
)
def test_damaged_reviews_are_refused_with_the_remedy(tracked, tmp_path, content):
    path = tmp_path / "towel.review.json"
    path.write_bytes(content)
    with pytest.raises(InvalidResultError, match="review the labels again"):
        read_review(path, tracked)


def test_a_folder_in_the_place_of_the_file_is_refused(tracked, tmp_path):
    (tmp_path / "towel.review.json").mkdir()
    with pytest.raises(InvalidResultError, match="not a review"):
        read_review(tmp_path / "towel.review.json", tracked)
