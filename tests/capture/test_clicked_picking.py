"""A bare hand by clicks: on the shipped recording, whose true path is known."""

import json

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack_capture.clicked_picking import ClickedPicking
from clothtrack_capture.cloth_views import Click

PICK, PLACE = Click(4, 250, 63), Click(15, 217, 127)
NEXT_PICK, NEXT_PLACE = Click(23, 55, 86), Click(40, 132, 97)
"""The true picks and places are in the frames 2, 17, 24 and 39, at pixels two away at most."""


@pytest.fixture
def picking(folder):
    recording = ct.read_recording(folder)
    return ClickedPicking(recording, recording.cameras[0])


@pytest.fixture(scope="module")
def true_path():
    return ct.read_recording(ct.shipped_recording()).picker_paths["gripper"]


def words(*clicks):
    flags = ("--pick", "--place")
    return [
        str(word)
        for number, click in enumerate(clicks)
        for word in (flags[number % 2], click.frame, click.column, click.row)
    ]


def test_the_path_from_clicks_is_near_the_true_one(folder, true_path):
    assert cli.main(["find-picker", str(folder), *words(PICK, PLACE, NEXT_PICK, NEXT_PLACE)]) == 0
    recording = ct.read_recording(folder)
    path = recording.picker_paths["hand"]
    held = true_path.closed
    off_m = np.array(
        [
            np.linalg.norm(path.position_at(time_s) - position)
            for time_s, position in zip(
                true_path.time_s[held], true_path.positions[held], strict=True
            )
        ]
    )
    assert off_m.mean() < 0.016
    for pick_s in (0.2, 2.4):
        took_s = path.time_s[1:][path.closed[1:] & ~path.closed[:-1]]
        assert np.abs(took_s - pick_s).min() < 0.15
    first, second = recording.actions
    assert first.last_frame == second.first_frame
    assert 17 <= first.last_frame <= 22
    assert second.last_frame == len(recording.frames) - 1
    assert first.pickers == second.pickers == ("hand",)
    # What a person clicked stands in the recording; what was said of another path does not.
    assert recording.cloth.grasp_uncertainty_m == 0.0
    by_clicks = recording.provenance["picker_found"]
    assert by_clicks["by"] == "clicks"
    assert by_clicks["actions"][0]["pick"] == [4, 250, 63]


def test_a_pick_is_on_the_cloth_as_it_lay_not_on_the_hand_over_it(picking, true_path):
    picking.add(PICK)
    picking.add(PLACE)
    (action,) = picking.actions()
    assert action.seen
    assert np.linalg.norm(action.path.pick - true_path.positions[2]) < 0.006
    assert 0.0 < action.path.pick[2] < 0.008


@pytest.mark.parametrize(
    ("clicks", "told"),
    [
        ([Click(2, 300, 220)], "nothing within 15 mm of the pick (300, 220) is cloth"),
        ([Click(43, 250, 63)], "there is no frame 43; choose one from 0 to 42"),
        ([Click(-1, 250, 63)], "there is no frame -1"),
        ([Click(2, 320, 63)], "outside the picture of 320 x 240"),
        ([PICK, Click(4, 217, 127)], "the place in frame 4 is not after the pick in frame 4"),
        ([PICK, PLACE, Click(9, 55, 86)], "the pick in frame 9 is not after the last place"),
    ],
)
def test_a_wrong_click_is_refused_and_changes_nothing(picking, clicks, told):
    for click in clicks[:-1]:
        picking.add(click)
    with pytest.raises(InvalidConfigError) as refused:
        picking.add(clicks[-1])
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)
    assert picking.clicks == tuple(clicks[:-1])


def test_a_pick_without_a_place_is_not_written(picking, folder, contents):
    before = contents(folder)
    with pytest.raises(InvalidConfigError, match="nothing is clicked yet"):
        picking.keep("hand")
    picking.add(PICK)
    with pytest.raises(InvalidConfigError, match="the last pick has no place"):
        picking.keep("hand")
    assert contents(folder) == before


def test_actions_that_touch_make_a_valid_recording(picking, folder):
    for click in (PICK, PLACE, Click(16, 217, 127), Click(17, 200, 120)):
        picking.add(click)
    picking.keep("hand")
    path = ct.read_recording(folder).picker_paths["hand"]
    assert (np.diff(path.time_s) > 0.0).all()
    assert np.count_nonzero(path.closed[1:] & ~path.closed[:-1]) + path.closed[0] == 2


def test_without_mask_and_color_a_hand_would_be_cloth(folder):
    document = json.loads((folder / "recording.json").read_text())
    del document["cloth"]["color"]
    (folder / "recording.json").write_text(json.dumps(document))
    recording = ct.read_recording(folder)
    with pytest.raises(InvalidRecordingError, match="run clothtrack segment first"):
        ClickedPicking(recording, recording.cameras[0])


def test_the_command_refuses_half_an_action_two_ways_and_a_measured_path(folder, capsys, contents):
    assert cli.main(["find-picker", str(folder), *words(PICK)]) == 2
    assert "1 --pick and 0 --place" in capsys.readouterr().err
    assert cli.main(["find-picker", str(folder), "--tip-color", "pink", "--by-hand"]) == 2
    assert "--by-hand, --tip-color NAME, or" in capsys.readouterr().err
    measured = ct.shipped_recording()
    before = contents(measured)
    assert cli.main(["find-picker", str(measured), *words(PICK, PLACE)]) == 1
    assert "--force" in capsys.readouterr().err
    assert contents(measured) == before


def test_the_command_writes_json_of_what_it_found(folder, capsys):
    assert cli.main(["find-picker", str(folder), *words(PICK, PLACE), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    (row,) = report["actions"]
    assert report["picker"] == "hand"
    assert abs(row["pick"] - 2) <= 1
    assert abs(row["release"] - 17) <= 1
    assert row["seen"] is True
    # The path replaces itself when it is told to.
    assert cli.main(["find-picker", str(folder), *words(PICK, PLACE)]) == 1
    assert cli.main(["find-picker", str(folder), *words(PICK, PLACE), "--force"]) == 0
