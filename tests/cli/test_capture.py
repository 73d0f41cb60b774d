"""The verbs that set a recording up, from the command line on."""

import json

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import RecordingWriter, read_recording


@pytest.fixture
def table_film(tmp_path):
    """A tilted table, seen without knowing where the camera is."""
    camera = Camera("top", 64, 48, 60.0, 60.0, 31.5, 23.5)
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    inverse = 1.5 + 0.2 * (columns - 31.5) / 60.0 - 0.1 * (rows - 23.5) / 60.0
    folder = tmp_path / "film"
    with RecordingWriter(folder, [camera], {"top": 0.0001}) as writer:
        for frame in range(2):
            writer.add_frame(0.1 * frame, depth={"top": 1.0 / inverse})
    return folder


def test_calibrate_camera_writes_the_recording(table_film, capsys):
    assert cli.main(["calibrate-camera", str(table_film), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    recording = read_recording(table_film)
    np.testing.assert_allclose(told["world_from_camera"], recording.cameras[0].world_from_camera)
    assert told["fit"]["tilt_deg"] == pytest.approx(
        np.degrees(np.arctan2(np.hypot(0.2, 0.1), 1.5)), abs=0.02
    )
    assert recording.table is not None


def test_hand_eye_wants_a_board(table_film, tmp_path, capsys):
    words = ["calibrate-camera", str(table_film), "--robot-poses", str(tmp_path / "poses.csv")]
    assert cli.main(words) == 2
    assert "--charuco" in capsys.readouterr().err
    assert cli.main([*words, "--charuco", "7", "5", "0.03", "0.02"]) == 1
    assert "poses.csv" in capsys.readouterr().err


def test_a_click_beside_the_cloth_is_told_in_one_line(tmp_path, capsys):
    sheet = tmp_path / "masks.png"
    words = ["segment", str(shipped_recording()), "--click", "3", "3", "--sheet", str(sheet)]
    assert cli.main(words) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert "click (3, 3)" in shown.err
    assert "click on the cloth" in shown.err
    assert not sheet.exists()
