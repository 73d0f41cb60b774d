"""A recording in memory is set up as one in a folder is, and nothing is written."""

import json
from dataclasses import replace

import numpy as np
import pytest

import clothtrack as ct
import clothtrack_capture as capture
from clothtrack.cli import command_line as cli
from clothtrack.recordings.identity import recording_digest
from clothtrack.recordings.pictures import read_mask

CLICK, ENDS = (200, 120), {"pick": [(4, 250, 63)], "place": [(15, 217, 127)]}


@pytest.fixture
def folder(folder, edit):
    """The same as a camera gives it, with nothing but the kind of its cloth."""

    def forget(document):
        del document["table"], document["cameras"][0]["world_from_camera"]
        document["cloth"] = {"kind": "tshirt"}

    edit(folder, forget)
    return folder


def arrays_of(recording):
    return ct.Recording.from_arrays(
        [ct.read_depth(frame.depth["top"], 0.001) for frame in recording.frames],
        [
            ct.read_color(frame.color["top"])[..., ::-1].copy()[..., ::-1]
            for frame in recording.frames
        ],
        [frame.time_s for frame in recording.frames],
        recording.cameras[0],
        cloth=recording.cloth,
    )


@pytest.mark.parametrize("given", [lambda recording: recording, arrays_of], ids=["read", "arrays"])
def test_it_is_set_up_as_its_folder_is_and_nothing_is_written(folder, given, contents):
    before = contents(folder)
    recording = given(ct.read_recording(folder))
    placed = capture.calibrate_camera(recording)
    masked = capture.segment(placed, click=CLICK)
    ready = capture.find_picker(masked, **ENDS)
    assert contents(folder) == before
    assert recording.table is None
    assert not recording.actions
    assert ready.in_memory

    capture.calibrate_camera(folder)
    capture.segment(folder, click=CLICK)
    capture.find_picker(folder, **ENDS)
    there = ct.read_recording(folder)
    pose = there.cameras[0].world_from_camera
    np.testing.assert_allclose(ready.cameras[0].world_from_camera, pose, atol=1e-6)
    np.testing.assert_array_equal(ready.table.normal, there.table.normal)
    for here, written in zip(ready.frames, there.frames, strict=True):
        assert (read_mask(here.mask["top"]) != read_mask(written.mask["top"])).mean() < 1e-4
    assert ready.actions == there.actions
    path = there.picker_paths["hand"].positions
    np.testing.assert_allclose(ready.picker_paths["hand"].positions, path, atol=1e-4)
    assert set(ready.provenance) >= {"camera_placement", "masks_from", "picker_found"}
    assert recording_digest(ready) != recording_digest(placed)


def test_it_is_tracked(folder):
    recording = arrays_of(ct.read_recording(folder))
    with pytest.raises(ct.InvalidRecordingError, match="calibrate_camera"):
        ct.track(replace(recording, cloth=ct.ClothDescription("towel", "red")), mode="open_loop")
    placed = capture.calibrate_camera(recording)
    ready = capture.find_picker(capture.segment(placed, click=CLICK), **ENDS)
    run = ct.track(ready, mode="open_loop", force=True)
    assert run.positions.shape[0] == len(ready.frames)
    assert run.recording is ready


def test_a_click_writes_the_masks_and_the_picker_is_found_next(folder, tmp_path, capsys):
    sheet = tmp_path / "masks.png"
    assert cli.main(["calibrate-camera", str(folder)]) == 0
    words = ["segment", str(folder), "--click", *map(str, CLICK)]
    assert cli.main([*words, "--json"]) == 0
    said = capsys.readouterr().out
    count = json.loads(said[said.index("{") :])["masks"]
    recording = ct.read_recording(folder)
    assert count == len(recording.frames) == sum("top" in frame.mask for frame in recording.frames)
    assert not list(tmp_path.rglob("masks.png"))
    ends = ["--pick", "4", "250", "63", "--place", "15", "217", "127"]
    assert cli.main(["find-picker", str(folder), *ends]) == 0
    assert len(ct.read_recording(folder).actions) == 1
    assert cli.main([*words, "--sheet", str(sheet)]) == 0
    assert f"{sheet}   (look at it)" in capsys.readouterr().out
    assert sheet.exists()
