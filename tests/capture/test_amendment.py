"""Changing a recording in place: whole before, whole after, and what is not spoken of stays."""

import json

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.recording import PickAndPlace, PickerPath
from clothtrack.recordings.store import read_recording
from clothtrack_capture import amendment
from clothtrack_capture.amendment import amend_document, set_actions, set_masks


def names(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_only_what_is_changed_changes_and_nothing_against_the_rules(write, tmp_path):
    write(tmp_path / "a")
    before = json.loads((tmp_path / "a" / "recording.json").read_text())
    files = names(tmp_path / "a")
    amend_document(tmp_path / "a", lambda document: document["cloth"].update(color="red"))
    after = json.loads((tmp_path / "a" / "recording.json").read_text())
    assert after["cloth"].pop("color") == "red"
    before["cloth"].pop("color")
    assert after == before
    with pytest.raises(InvalidRecordingError, match="the change is refused"):
        amend_document(tmp_path / "a", lambda document: document.update(cameras=[]))
    assert read_recording(tmp_path / "a").cloth.color == "red"
    assert names(tmp_path / "a") == files


def test_new_actions_come_with_their_paths(write, tmp_path):
    recording = write(tmp_path / "a")
    path = PickerPath(np.array([0.0, 2.0]), np.zeros((2, 3)), np.array([True, False]))
    set_actions(
        recording, {"hand": path}, (PickAndPlace(1, 3, ("hand",)),), provenance={"found": "yes"}
    )
    again = read_recording(tmp_path / "a")
    assert again.actions == (PickAndPlace(1, 3, ("hand",)),)
    assert set(again.picker_paths) == {"hand"}
    assert again.cloth.held_vertices == {}
    assert again.provenance == {"made_by": "test", "found": "yes"}


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_wherever_it_is_broken_off_the_recording_can_be_read(write, tmp_path, monkeypatch, steps):
    recording = write(tmp_path / "a")
    replace, done = amendment.write_file, []

    def breaking(path, data):
        if len(done) == steps:
            raise KeyboardInterrupt
        done.append(path)
        replace(path, data)

    monkeypatch.setattr(amendment, "write_file", breaking)
    path = PickerPath(np.array([0.0, 2.0]), np.zeros((2, 3)), np.array([True, False]))
    with pytest.raises(KeyboardInterrupt):
        set_actions(recording, {"hand": path}, (PickAndPlace(1, 3, ("hand",)),), provenance={})
    again = read_recording(tmp_path / "a")
    assert len(again.actions) == (2 if steps == 0 else 0)


@pytest.mark.parametrize("named", [True, False])
def test_masks_are_replaced_as_a_whole(write, edit, tmp_path, named):
    write(tmp_path / "a")

    def conventional(document):
        for entry in document["frames"]:
            for kind in ("color", "depth", "mask"):
                del entry[kind]

    if not named:
        edit(tmp_path / "a", conventional)
    recording = read_recording(tmp_path / "a")

    def mask_of(frame):
        mask = np.zeros((48, 64), dtype=bool)
        mask[: frame.index] = True
        return mask

    changed = set_masks(recording, "top", mask_of, color="green", provenance={"by": "click"})
    again = read_recording(tmp_path / "a")
    assert changed.frames == again.frames
    assert not again.frames[0].mask
    for frame in again.frames[1:]:
        np.testing.assert_array_equal(read_mask(frame.mask["top"]), mask_of(frame))
    assert [frame.depth for frame in again.frames] == [frame.depth for frame in recording.frames]
    assert [frame.color for frame in again.frames] == [frame.color for frame in recording.frames]
    assert again.cloth.color == "green"
    assert not (tmp_path / "a" / "mask").exists()
    assert sorted(path.name for path in (tmp_path / "a").iterdir() if path.is_dir()) == [
        "color", "depth", "mask2",
    ]  # fmt: skip


def test_a_mask_that_cannot_be_made_leaves_the_recording_as_it_was(write, tmp_path):
    recording = write(tmp_path / "a")
    before = names(tmp_path / "a")

    def failing(frame):
        if frame.index == 3:
            raise KeyboardInterrupt
        return np.ones((48, 64), dtype=bool)

    with pytest.raises(KeyboardInterrupt):
        set_masks(recording, "top", failing, provenance={})
    assert names(tmp_path / "a") == before
