"""A recording that was corrected after it had been tracked is tracked again, or a warning tells."""

import json
import shutil

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

# What is tracked does not matter here: long substeps and few iterations.
FAST = (
    "--set", "search.method=none", "--set", "cloth.substep_s=3.3e-3",
    "--set", "objective.iterations=20",
)  # fmt: skip


@pytest.fixture(scope="module")
def once(towels, tmp_path_factory):
    """A towel, tracked; the recording was not changed yet."""
    folder = tmp_path_factory.mktemp("corrected")
    shutil.copytree(towels / "recordings" / "towel_0001", folder / "recordings" / "towel")
    words = ["track", str(folder / "recordings" / "towel"), "--output", str(folder / "tracked")]
    assert cli.main([*words, *FAST]) == 0
    return folder


@pytest.fixture
def tracked(once, tmp_path):
    """A copy of it that a test may change; the recording lies elsewhere now, and is the same."""
    shutil.copytree(once, tmp_path / "towel")
    return tmp_path / "towel"


def correct_the_path(folder):
    """The tip went half as far again in x as its path said."""
    head, *rows = (folder / "picker.csv").read_text().splitlines()
    column = head.split(",").index("x_m")
    moved = [row.split(",") for row in rows]
    for row in moved:
        row[column] = str(1.5 * float(row[column]))
    (folder / "picker.csv").write_text("\n".join([head, *map(",".join, moved)]) + "\n")


def test_a_corrected_recording_is_tracked_again(tracked, capsys):
    recording, result = tracked / "recordings" / "towel", tracked / "tracked" / "towel.zarr"
    words = ["track", str(recording), "--output", str(tracked / "tracked"), *FAST]
    assert cli.main(words) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first == f"{result}   (finished before)"
    assert second.strip().split(":")[0] in ("trust", "look", "reject")
    before = TrackedTrajectory.load(result)

    correct_the_path(recording)
    assert cli.main([*words, "--set", "cloth.thickness_m=0.002"]) == 1
    assert "other settings" in capsys.readouterr().err
    assert cli.main(words) == 0
    assert capsys.readouterr().out.startswith(f"{result}   (recording changed, tracked again)\n")
    after = TrackedTrajectory.load(result)
    assert not np.array_equal(after.positions, before.positions)
    assert after.provenance["recording_sha256"] != before.provenance["recording_sha256"]
    assert [path.name for path in (tracked / "tracked").glob("[!.]*")] == ["towel.zarr"]

    assert cli.main([*words, "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert told["skipped"]
    assert not told["tracked_again"]


def test_a_recording_that_became_unreadable_leaves_its_result(tracked, capsys):
    recording, result = tracked / "recordings" / "towel", tracked / "tracked" / "towel.zarr"
    (recording / "picker.csv").write_text("nothing\n")
    words = ["track", str(recording), "--output", str(tracked / "tracked"), *FAST]
    assert cli.main(words) == 1
    assert capsys.readouterr().err.count("\n") == 1
    TrackedTrajectory.load(result)


@pytest.mark.parametrize(
    ("verb", "more"),
    [
        ("evaluate", []),
        pytest.param("label", ["--output", "labels"], marks=pytest.mark.slow),
        pytest.param("view", ["--html", "page.html"], marks=pytest.mark.slow),
        pytest.param(
            "export", ["--format", "sheet", "--output", "sheet.png"], marks=pytest.mark.slow
        ),
    ],
)
def test_a_result_that_is_older_than_its_recording_is_told(
    tracked, monkeypatch, caplog, verb, more
):
    monkeypatch.chdir(tracked)
    words = [verb, "tracked/towel.zarr", "--recordings", "recordings", *more]
    assert cli.main(words) == 0
    assert caplog.messages == []
    document = json.loads((tracked / "recordings" / "towel" / "recording.json").read_text())
    document["cloth"]["grasp_uncertainty_m"] = 0.01
    (tracked / "recordings" / "towel" / "recording.json").write_text(json.dumps(document))
    assert cli.main(words) == 0
    (line,) = caplog.messages
    assert "tracked/towel.zarr is older than its recording " in line
    assert "recordings/towel (" in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("verb", "more"),
    [
        ("evaluate", []),
        pytest.param("evaluate", ["--output", "measures.json"], marks=pytest.mark.slow),
        pytest.param("label", ["--output", "labels"], marks=pytest.mark.slow),
    ],
)
def test_a_refusal_of_a_damaged_picture_is_one_line(tracked, monkeypatch, capsys, verb, more):
    monkeypatch.chdir(tracked)
    last = max((tracked / "recordings" / "towel" / "depth").glob("*.png"))
    content = bytearray(last.read_bytes())
    content[len(content) // 2] ^= 1
    last.write_bytes(content)
    assert cli.main([verb, "tracked/towel.zarr", "--recordings", "recordings", *more]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{last.name}: the picture is damaged" in line
