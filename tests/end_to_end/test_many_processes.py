"""Several workers, and a run that is killed: the same bits as one process that nobody disturbs."""

import hashlib
import json
import shutil

import pytest

from clothtrack.cli import command_line as cli

pytestmark = pytest.mark.slow

FAST = ("--set", "search.method=none", "--set", "cloth.substep_s=3.3e-3")
TINY = (
    "size_m=[0.2, 0.2]", "vertex_count=120", "template.vertex_count=100", "sensor.width=80",
    "sensor.height=60", "sensor.focal=75", "actions=1",
)  # fmt: skip
SMALL = tuple(word for setting in TINY for word in ("--set", setting))
STATES = (
    "--states", "12", "--set", "vertex_count=120", "--set", "episodes=2",
    "--set", "crumpling.states=2", "--set", "crumpling.rest_limit_s=0.2",
)  # fmt: skip


def ended_well(*processes):
    for process in processes:
        _, complained = process.communicate(timeout=300)
        assert process.returncode == 0, complained


def bits(folder, pattern):
    """Digests of files, but those that hold CPU times, by their names."""
    files = [path for path in folder.glob(pattern) if path.is_file() and path.name != "zarr.json"]
    assert files
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def no_litter(out):
    assert not list(out.rglob(".*"))


@pytest.mark.parametrize(
    ("words", "pattern"),
    [
        (("--trajectories", "3", *SMALL), "[rt]*/**/*"),
        (STATES, "shards/**/*"),
    ],
)
def test_two_workers_make_what_one_makes(start, tmp_path, words, pattern):
    together, alone = tmp_path / "together", tmp_path / "alone"
    ended_well(start("simulate", together, *words, "--workers", 2))
    assert cli.main(["simulate", str(alone), *words]) == 0
    assert bits(together, pattern) == bits(alone, pattern)
    no_litter(together)
    if words is STATES:
        assert len(json.loads((together / "states.json").read_text())["shards"]) == 3


def test_a_killed_run_goes_on_to_the_bits_of_one_that_was_not(
    start, wait_until, towels, tmp_path, capsys
):
    """Then labels and measures by two workers; they are kept; and what a bad recording does."""
    folders = [tmp_path / "recordings" / f"towel_{letter}" for letter in "abcd"]
    for folder in folders:
        shutil.copytree(towels / "recordings" / "towel_0002", folder)
    out, alone = tmp_path / "out", tmp_path / "alone"
    words = ("track", *folders, *FAST, "--output")
    killed = start(*words, out, "--workers", 2)
    wait_until(lambda: list(out.glob("*.zarr")), killed)
    killed.kill()
    killed.communicate()
    finished = {path: path.stat().st_mtime_ns for path in out.glob("*.zarr/zarr.json")}
    assert 1 <= len(finished) < len(folders)
    ended_well(start(*words, out, "--workers", 2))
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert cli.main([*map(str, words), str(alone)]) == 0
    tracked = sorted(out.glob("*.zarr"))
    assert [path.stem for path in tracked] == [folder.name for folder in folders]
    for path in tracked:
        assert bits(path, "positions/**/*") == bits(alone / path.name, "positions/**/*")
    no_litter(out)

    labels, measures = tmp_path / "labels", tmp_path / "measures" / "all.json"
    at = ("--recordings", tmp_path / "recordings", "--output")
    ended_well(start("evaluate", *tracked, *at, measures, "--workers", 2))
    assert [one["name"] for one in json.loads(measures.read_text())] == [
        folder.name for folder in folders
    ]
    again = tmp_path / "again.json"
    assert cli.main(["evaluate", *map(str, (*tracked, *at, again))]) == 0
    assert again.read_bytes() == measures.read_bytes()
    pytest.importorskip("torch")
    ended_well(start("label", *tracked, *at, labels, "--workers", 2))
    written = files_of(labels)
    assert len(written) == 4
    assert cli.main(["label", *map(str, (*tracked, *at, labels))]) == 0
    assert files_of(labels) == written
    assert cli.main(["label", *map(str, (*tracked[:1], *at, labels)), "--garment", "towel"]) == 0
    changed = {path for path, when in files_of(labels).items() if written[path] != when}
    assert changed == {labels / "towel_a.labels.npz"}

    (folders[0] / "recording.json").write_text("{")
    capsys.readouterr()
    assert cli.main([*map(str, words), str(out), "--workers", "2"]) == 1
    said = capsys.readouterr()
    assert said.out.count("(finished before)") == 3
    assert str(folders[0]) in said.err


def files_of(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
