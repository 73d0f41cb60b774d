"""The verb on the command line: what it says, and what it says of wrong input."""

import json
import os

import pytest
from import_makers import Film, Messages, stream, write_ros2

from clothtrack.cli import command_line as cli
from clothtrack.recordings.store import read_recording

ROS2 = Messages(cdr=True)


@pytest.fixture
def source(tmp_path):
    return write_ros2(tmp_path / "bag", stream(Film(), ROS2), ROS2)


def test_it_says_what_was_found_and_what_is_missing(source, tmp_path, capsys):
    assert cli.main(["import", str(source), str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    for words in (
        "4 in 0.1", "camera, 32 x 24", "REP 118", "aligned_depth_to_color", "none needed",
        "tolerance 16.7 ms", "picker's path", "clothtrack calibrate-camera", "--cloth-color",
        "the cloth's kind: --cloth towel or tshirt", f"clothtrack segment {tmp_path / 'out'}",
    ):  # fmt: skip
        assert words in told
    assert read_recording(tmp_path / "out").cloth.color is None


def test_json(source, tmp_path, capsys):
    words = ["import", str(source), str(tmp_path / "out"), "--json", "--cloth-color", "blue",
             "--cloth", "towel"]  # fmt: skip
    assert cli.main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frames"] == 4
    assert told["recording"] == str(tmp_path / "out")
    assert not any(one.startswith(("which pixels", "the cloth's kind")) for one in told["missing"])
    cloth = read_recording(tmp_path / "out").cloth
    assert (cloth.kind, cloth.color) == ("towel", "blue")


@pytest.mark.parametrize(
    "words",
    [
        ["--depth-topic", "/no"], ["--color-topic", "/no"], ["--depth-unit-m", "-1"],
        ["--depth-unit-m", "nan"], ["--fps", "0"], ["--picker-csv", "no.csv"],
        ["--intrinsics", "no.json"], ["--world-from-camera", "no.json"], ["--actions", "0-3"],
        ["--cloth-color", "mauve"], ["--depth-unit-m", "1.0"],
        ["--picker-topic", "/camera/color/image_raw"],
    ],
)  # fmt: skip
def test_wrong_options_end_with_one_line_and_leave_nothing(words, source, tmp_path, capsys):
    assert cli.main(["import", str(source), str(tmp_path / "out"), *words]) == 1
    told = capsys.readouterr()
    assert told.err.startswith("clothtrack: ")
    assert told.err.count("\n") == 1
    assert sorted(one.name for one in tmp_path.iterdir()) == ["bag"]


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("missing", lambda path: None),
        ("empty", lambda path: path.touch()),
        ("text", lambda path: path.write_text("not a bag\n" * 100)),
        ("folder", lambda path: path.mkdir()),
        ("empty bag", lambda path: path.write_bytes(b"#ROSBAG V2.0\n")),
        ("pipe", os.mkfifo),
        ("link", lambda path: path.symlink_to(path)),
    ],
)
def test_wrong_sources_are_named(kind, make, tmp_path, capsys):
    source = tmp_path / "source"
    make(source)
    assert cli.main(["import", str(source), str(tmp_path / "out")]) == 1
    assert str(source) in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_path_and_the_table_share_one_world(source, tmp_path, capsys):
    """Import, calibrate aside, import again: the order that the report tells."""
    path, camera = tmp_path / "path.csv", tmp_path / "camera.json"
    path.write_text("time,x,y,z\n0,0,0,0.5\n0.1,0,0,0.5\n")
    words = ["import", str(source), str(tmp_path / "one"), "--picker-csv", str(path)]
    assert cli.main(words) == 0
    told = capsys.readouterr().out
    assert f"next: clothtrack calibrate-camera {tmp_path / 'one'} --output camera.json" in told
    assert "import again with --world-from-camera camera.json" in told
    table = {"point": [0.0, 0.0, 0.1], "normal": [0.0, 0.0, 1.0]}
    pose = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]
    words[2:3] = [str(tmp_path / "two"), "--world-from-camera", str(camera)]
    for wrong in ([1], {"point": [0, 0], "normal": [0, 0, 1]}, {**table, "normal": [0, 0, 2]}):
        camera.write_text(json.dumps({"world_from_camera": pose, "table": wrong}))
        assert cli.main(words) == 1
        assert "table" in capsys.readouterr().err
    camera.write_text(json.dumps({"world_from_camera": pose, "table": table}))
    assert cli.main(words) == 0
    assert "calibrate-camera" not in capsys.readouterr().out
    recording = read_recording(tmp_path / "two")
    assert recording.table.point.tolist() == table["point"]
    assert recording.table.normal.tolist() == table["normal"]
    assert recording.cameras[0].world_from_camera.tolist() == pose
