"""What a round learns from is counted, kept, and nothing but the labels that teach."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra [learn] brings it")

from shared import round_labels
from shared.round_labels import (
    EXPECTED,
    EpisodeLabels,
    read_worth,
    taught,
    worth_of,
    write_worth,
)

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_worth import LabelWorth, better_than_network
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction import model_loading
from clothtrack.reconstruction.data.labelled_picture import LabelledPicture
from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording, write_labels
from clothtrack.tracking.pipeline import Outcome


def labelled(folder, name, expected):
    """A file of labels with these expected errors [mm], by frame."""
    mesh = garment("towel", vertex_count=60)
    camera = Camera("top", 8, 6, 5.0, 5.0, 3.5, 2.5)
    depth = np.full((6, 8), 0.5)
    faces = np.zeros((6, 8), np.int32)
    pictures = tuple(
        LabelledPicture(depth, depth > 0, camera, faces, mesh.vertices + 0.01 * frame)
        for frame in expected
    )
    provenance = {EXPECTED: {str(frame): mm for frame, mm in expected.items()}}
    path = folder / f"{name}.labels.npz"
    frames = tuple(expected)
    write_labels(LabelledRecording(name, "towel", mesh, frames, pictures, provenance), path)
    return EpisodeLabels(path, folder / name)


@pytest.fixture
def labels(tmp_path):
    return [
        labelled(tmp_path, "towel_0000", {4: 6.0, 9: 12.0}),
        labelled(tmp_path, "towel_0001", {5: 20.0}),
        labelled(tmp_path, "towel_0002", {3: 20.0, 7: 9.0}),
    ]


@pytest.fixture
def weights(monkeypatch):
    """A network that expects to be 10 mm off in the first recording, 15 in the others."""

    def expects(model, recording, frame, *, kind, template=None, device="cpu"):
        assert (model, kind, template, device) == ("network", "towel", None, "cpu")
        return 10.0 if recording.name == "towel_0000" else 15.0

    monkeypatch.setattr(model_loading, "load_model", lambda *_, **__: "network")
    monkeypatch.setattr(round_labels, "network_error_mm", expects)
    return Path("weights")


def test_labels_that_are_worse_than_the_network_are_left_out(labels, weights):
    worth = worth_of(labels, weights, "towel", better_than_network)
    assert [(one.recording, one.frame, one.used) for one in worth] == [
        ("towel_0000", 4, True),
        ("towel_0000", 9, False),
        ("towel_0001", 5, False),
        ("towel_0002", 3, False),
        ("towel_0002", 7, True),
    ]
    assert [one.label_mm for one in worth] == [6.0, 12.0, 20.0, 20.0, 9.0]
    chosen = taught(labels, worth)
    assert [(one.name, one.frames) for one in chosen] == [
        ("towel_0000", (4,)),
        ("towel_0002", (7,)),
    ]
    mesh = chosen[1].mesh.vertices
    np.testing.assert_allclose(chosen[1].pictures[0].positions, mesh + 0.07, atol=1e-6)


def test_another_function_decides_otherwise(labels, weights):
    everything = taught(labels, worth_of(labels, weights, "towel", lambda *_: True))
    assert [len(one.pictures) for one in everything] == [2, 1, 2]
    assert taught(labels, worth_of(labels, weights, "towel", lambda *_: False)) == []


def test_what_was_decided_is_kept(tmp_path):
    worth = [LabelWorth("a", 3, 5.0, None, used=True), LabelWorth("a", 8, 9.0, 4.0, used=False)]
    path = tmp_path / "worth.json"
    write_worth(path, worth)
    assert read_worth(path) == worth
    assert [one["network_mm"] for one in json.loads(path.read_text())] == [None, 4.0]
    path.write_text(path.read_text()[:40])
    with pytest.raises(InvalidResultError, match="remove it"):
        read_worth(path)


def test_an_expected_error_has_that_of_the_first_mesh_in_it(tmp_path, monkeypatch):
    written = []
    mesh = garment("towel", vertex_count=60)
    tracked = SimpleNamespace(
        provenance={"initial_state": {"source": "network", "expected_error_m": 0.008}}, mesh=mesh
    )
    judged = (SimpleNamespace(frame=4, expected_error_mm=6.0),)
    chosen = [SimpleNamespace(frame=4)]
    monkeypatch.setattr(round_labels, "load_tracked", lambda path: tracked)
    monkeypatch.setattr(round_labels, "read_recording", lambda path: None)
    monkeypatch.setattr(round_labels, "judge_labels", lambda *_, **__: judged)
    selection = "clothtrack.evaluation.label_selection.pseudo_labels_of"
    monkeypatch.setattr(selection, lambda *_, **__: chosen)
    pseudo = "clothtrack.reconstruction.data.pseudo_labels"
    monkeypatch.setattr(f"{pseudo}.label_recording", lambda *_, **more: more["provenance"])
    monkeypatch.setattr(f"{pseudo}.write_labels", lambda one, path: written.append(one))
    outcome = Outcome(tmp_path, tmp_path)
    assert round_labels._labelled(outcome, tmp_path / "one", "towel", device="cpu")
    assert written[0][EXPECTED] == {"4": 10.0}
