"""Pseudo-labels: projected to what the camera sees, cut where the mesh is far, whole on disk."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_review import LabelReview
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.pseudo_labels import (
    PseudoLabel,
    label_recording,
    projected_faces,
    read_labels,
    write_labels,
)
from clothtrack.recordings.recording import ClothDescription
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

POSE = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.7], [0, 0, 0, 1]])
CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, POSE)
TOWEL = garment("towel", vertex_count=300, size_m=(0.2, 0.2))


def folded(gap_m=0.006):
    """The towel's right half folded over its left one."""
    x, y, _ = np.asarray(TOWEL.vertices).T
    return np.column_stack([-np.abs(x), y, np.where(x > 0, 0.004 + gap_m, 0.004)])


def perfect_picture(positions, faces=TOWEL.faces):
    drawn = Rasterizer(faces, CAMERA).render(positions)
    seen = drawn.faces >= 0
    return np.where(seen, drawn.depth, 0.7).astype(np.float32), seen, drawn.faces


def test_pixels_show_the_layer_that_is_seen():
    """The hidden layer is nearer than the noise, and yet no pixel is given to it."""
    positions = folded(gap_m=0.002)
    depth, seen, truth = perfect_picture(positions)
    noisy = depth + 0.002 * np.random.default_rng(0).standard_normal(depth.shape)
    shown = projected_faces(noisy, seen, CAMERA, positions, TOWEL.faces, cut_m=0.02)
    assert (shown[~seen] == -1).all()
    assert (shown[seen] >= 0).mean() > 0.99
    upper = TOWEL.vertices[TOWEL.faces].mean(axis=1)[:, 0] > 0
    both = seen & (shown >= 0)
    assert (upper[shown[both]] == upper[truth[both]]).mean() > 0.97


def test_pixels_far_from_the_mesh_have_no_label():
    positions = folded()
    depth, seen, _ = perfect_picture(positions)
    moved = positions + (0.04, 0.0, 0.0)
    shown = projected_faces(depth, seen, CAMERA, moved, TOWEL.faces, cut_m=0.02)
    points = CAMERA.back_project(depth, seen)
    far = points[:, 0] < moved[:, 0].min() - 0.021
    near = points[:, 0] > moved[:, 0].min() + 0.003
    assert far.sum() > 50
    assert (shown[seen][far] == -1).all()
    assert (shown[seen][near] >= 0).mean() > 0.99


@pytest.fixture
def recording(tmp_path):
    """Two frames of a towel: flat, then folded."""
    folder = tmp_path / "fold"
    flat = np.asarray(TOWEL.vertices) + (0.0, 0.0, 0.004)
    with RecordingWriter(
        folder, [CAMERA], {"top": 1e-4}, cloth=ClothDescription(kind="towel")
    ) as writer:
        for number, positions in enumerate((flat, folded())):
            depth, seen, _ = perfect_picture(positions)
            writer.add_frame(0.1 * number, depth={"top": depth}, mask={"top": seen})
    return read_recording(folder), (flat, folded())


def labeled(recording):
    source, states = recording
    labels = [PseudoLabel(number, positions) for number, positions in enumerate(states)]
    return label_recording(source, TOWEL, labels, kind="towel", provenance={"mode": "default"})


@pytest.fixture
def tracked(recording):
    """The fold, tracked without a fault."""
    _, (flat, end) = recording
    none = Calibration("none", (), np.zeros((0, 0)), np.zeros(0), -1, 0.0)
    action = TrackedAction(0, 1, end, end, np.zeros(2), {}, none, {})
    return TrackedTrajectory(
        name="fold",
        mesh=TOWEL,
        frames=np.arange(2),
        time_s=np.array([0.0, 0.1]),
        positions=np.stack([flat, end]).astype(np.float32),
        visible=np.ones((2, len(flat)), bool),
        actions=(action,),
        steps=StepRecords.empty(2),
    )


def test_the_verb_labels_what_was_tracked(recording, tracked, tmp_path, capsys):
    """The first frame, and the end of the action."""
    source, (_, end) = recording
    tracked.save(tmp_path / "fold.zarr")
    words = ["label", str(tmp_path / "fold.zarr"), "--recordings", str(source.folder)]
    assert cli.main([*words, "--output", str(tmp_path / "labels"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    found = read_labels(tmp_path / "labels" / "fold.labels.npz")
    assert tuple(row["frames"]) == found.frames == (0, 1)
    np.testing.assert_allclose(found.pictures[1].positions, end, atol=1e-6)


def test_the_verb_leaves_out_what_a_person_rejected(recording, tracked, tmp_path, capsys):
    source, _ = recording
    tracked.save(tmp_path / "fold.zarr")
    LabelReview.blank(tracked).decided(0, "rejected").save(tmp_path / "fold.review.json")
    words = ["label", str(tmp_path / "fold.zarr"), "--recordings", str(source.folder)]
    words += ["--output", str(tmp_path / "labels")]
    assert cli.main(words) == 0
    assert "1 labels; 1 rejected in review left out" in capsys.readouterr().out
    found = read_labels(tmp_path / "labels" / "fold.labels.npz")
    assert found.frames == (0,)
    assert found.provenance["rejected_actions"] == [0]
    (tmp_path / "fold.review.json").write_text("{}")
    assert cli.main(words) == 1
    assert "fold.review.json: not a review" in capsys.readouterr().err


def test_labels_come_back_from_the_disk(recording, path):
    written, found = labeled(recording), read_labels(path)
    assert (found.name, found.kind, found.frames) == ("fold", "towel", (0, 1))
    assert found.provenance == {"mode": "default"}
    np.testing.assert_allclose(found.mesh.canonical, TOWEL.canonical, atol=1e-7)
    before, after = written.pictures[1], found.pictures[1]
    np.testing.assert_array_equal(after.mask, before.mask)
    np.testing.assert_array_equal(after.faces, before.faces)
    np.testing.assert_allclose(after.depth_m, np.where(before.mask, before.depth_m, 0.0), atol=1e-6)
    np.testing.assert_allclose(after.positions, before.positions, atol=1e-7)


def test_a_damaged_file_is_noticed(path):
    whole = path.read_bytes()
    place = whole.index(b"depth_m.npy") + 200
    altered = whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :]
    for content in (b"", whole[: len(whole) // 2], altered):
        path.write_bytes(content)
        with pytest.raises(InvalidResultError, match="not whole"):
            read_labels(path)


def test_an_array_that_is_gone_is_named_and_labels_from_before_are_read(path):
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays, sha256=np.array("{}"))
    assert len(read_labels(path).pictures) == 2
    del arrays["1/positions"]
    np.savez(path, **arrays)
    with pytest.raises(InvalidResultError, match=r"fold\.labels\.npz: .*1/positions"):
        read_labels(path)


def test_hostile_labels_run_nothing(tmp_path):
    target, path = tmp_path / "executed", tmp_path / "bad.labels.npz"
    with path.open("wb") as file:
        np.savez(file, document=np.array([Hostile(target)], dtype=object))
    with pytest.raises(InvalidResultError, match="not whole"):
        read_labels(path)
    assert not target.exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda one: {"positions": one.positions + 1e30}, "within 100 m"),
        (lambda one: {"faces": one.faces + 10_000}, "shows face"),
    ],
)
def test_labels_that_do_not_fit_their_mesh_are_refused(recording, path, change, told):
    one = labeled(recording)
    wrong = replace(one.pictures[0], **change(one.pictures[0]))
    write_labels(replace(one, frames=(0,), pictures=(wrong,)), path)
    with pytest.raises(InvalidResultError, match=told):
        read_labels(path)


@pytest.fixture
def path(recording, tmp_path):
    """Labels of the two frames."""
    file = tmp_path / "fold.labels.npz"
    write_labels(labeled(recording), file)
    return file


class Hostile:
    def __init__(self, target):
        self.target = str(target)

    def __reduce__(self):
        return Path.write_text, (Path(self.target), "executed")
