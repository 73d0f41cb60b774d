"""A first mesh that lies beside its cloud stops one recording, not the others, unless told."""

import json
import shutil

import pytest

import clothtrack as ct
from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidRecordingError
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

FAST = ("--set", "search.method=none")


@pytest.fixture
def recordings(towels, tmp_path):
    """A right recording, and one whose template lies half a meter beside the cloth."""
    for name in ("right", "wrong"):
        shutil.copytree(towels / "recordings" / "towel_0001", tmp_path / name)
    path = tmp_path / "wrong" / "template.obj"
    lines = path.read_text().splitlines()
    for number, line in enumerate(lines):
        if line.startswith("v "):
            x, y, z = map(float, line.split()[1:4])
            lines[number] = f"v {x + 0.5} {y} {z}"
    path.write_text("\n".join(lines) + "\n")
    return tmp_path / "wrong", tmp_path / "right"


def test_tracking_stops_at_a_far_first_mesh_and_goes_on_with_the_others(
    recordings, tmp_path, capsys
):
    wrong, right = recordings
    words = ["track", str(wrong), str(right), "--output", str(tmp_path / "out"), *FAST, "--json"]
    assert cli.main(words) == 1
    said = capsys.readouterr()
    stopped, tracked = json.loads(said.out)
    assert stopped["result"] is None
    assert stopped["verdict"] is None
    assert stopped["error"] in said.err
    for part in (str(wrong), "mm (rms) from the cloud of frame 0 (at most 20)", "cloth.template",
                 "--force"):  # fmt: skip
        assert part in stopped["error"]
    assert "\n" not in stopped["error"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"right.zarr"}
    assert tracked["verdict"]["word"] in ("trust", "look")
    assert 0.0005 < tracked["verdict"]["expected_error_m"] < 0.016
    stored = TrackedTrajectory.load(tmp_path / "out" / "right.zarr")
    assert 0.0 < stored.provenance["first_mesh_gap_m"] < 0.01


def test_it_goes_on_when_told_to_and_is_rejected_in_the_end(recordings, tmp_path, capsys):
    wrong, _ = recordings
    words = ["track", str(wrong), "--output", str(tmp_path / "out"), *FAST, "--force"]
    assert cli.main(words) == 0
    line, verdict, helps = capsys.readouterr().out.splitlines()
    assert helps.startswith("  what helps: clothtrack ")
    assert line == str(tmp_path / "out" / "wrong.zarr")
    assert verdict.startswith("  reject: expected error ")


def test_times_in_milliseconds_are_refused_before_a_minute_per_frame_is_simulated(recordings):
    _, right = recordings
    document = json.loads((right / "recording.json").read_text())
    for frame in document["frames"]:
        frame["time_s"] *= 1000.0
    (right / "recording.json").write_text(json.dumps(document))
    head, *lines = (right / "picker.csv").read_text().splitlines()
    column = head.split(",").index("time_s")
    rows = [line.split(",") for line in lines]
    for row in rows:
        row[column] = str(1000.0 * float(row[column]))
    (right / "picker.csv").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    with pytest.raises(InvalidRecordingError, match=r"frames are .* s apart.*0.001 times"):
        ct.track(right, settings=("search.method=none",))
