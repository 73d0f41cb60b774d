"""The command line: quick help, the right exit code, one clear line when something is wrong."""

import errno
import json
import os
import re
import resource
import subprocess
import sys

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidRecordingError
from clothtrack.files.extras import install_command


def run(*words):
    return subprocess.run(
        [sys.executable, "-m", "clothtrack.cli", *words],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip


def children_cpu_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


BARE = "import tyro\ndef peer(x: int = 1) -> None: ...\ntyro.cli(peer, args=['--help'])"
"""The least that a command line of this kind costs."""


def test_help_is_quick_and_lists_the_verbs_in_groups():
    ours, bare = [], []
    for _ in range(3):
        before = children_cpu_s()
        shown = run("--help")
        between = children_cpu_s()
        subprocess.run([sys.executable, "-c", BARE], capture_output=True, check=True)
        ours.append(between - before)
        bare.append(children_cpu_s() - between)
    assert shown.returncode == 0
    listed = re.findall(r"^  ([a-z0-9-]+)  ", shown.stdout, re.MULTILINE)
    # The main path first, then every other verb once, in its group.
    assert listed[:6] == ["demo", "import", "track", "live", "evaluate", "view"]
    assert sorted(listed) == sorted(cli.VERBS)
    # 3 times here, 0.27 s on a quiet machine; one stage that is loaded (Warp, MuJoCo) makes it 10.
    assert min(ours) < 5.0 * min(bare)


@pytest.mark.parametrize("words", [["--help"], ["track", "--help"], ["--version"]])
def test_a_reader_that_goes_away_is_no_error(words):
    """As in `clothtrack track --help | head`."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "clothtrack.cli", *words],
            stdout=closed, stderr=subprocess.PIPE, check=False, timeout=120,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")


def test_help_loads_no_stage():
    code = (
        "import sys\nfrom clothtrack.cli.command_line import main\n"
        "try:\n    main(['track', '--help'])\nexcept SystemExit:\n    pass\n"
        "sys.exit(len({'warp', 'scipy', 'cv2', 'zarr', 'mujoco'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


def test_bad_input_is_one_line_on_standard_error(tmp_path):
    told = run("export", str(tmp_path / "nothing.zarr"), "--output", str(tmp_path / "out"))
    assert told.returncode == 1
    assert told.stdout == ""
    assert told.stderr.count("\n") == 1
    assert "nothing.zarr" in told.stderr


def test_an_unusable_recording_is_inspected_with_exit_code_1(tmp_path, capsys):
    assert cli.main(["inspect", str(tmp_path), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["valid"] is False
    assert found["violations"]


def raising(error):
    def verb() -> None:
        """Fail."""
        raise error

    return verb


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (InvalidRecordingError("recording.json: no frames"), 1, "recording.json: no frames"),
        (OSError(errno.ENOSPC, "No space left on device", "out/a.zarr"), 1, "out/a.zarr: the disk"),
        (PermissionError(errno.EACCES, "Permission denied", "out"), 1, "out: no permission"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_can_go_wrong_is_said_in_one_line(monkeypatch, capsys, error, code, told):
    fail = raising(error)
    monkeypatch.setattr(cli, "VERBS", {"fail": lambda: fail})
    assert cli.main(["fail"]) == code
    shown = capsys.readouterr()
    assert told in shown.err
    assert shown.err.count("\n") == 1
    assert shown.out == ""


def test_a_value_of_any_length_leaves_the_file_and_the_next_step_in_sight(monkeypatch, capsys):
    fail = raising(InvalidRecordingError(f"a.json: kind is {'x' * 5_000}; write towel"))
    monkeypatch.setattr(cli, "VERBS", {"fail": lambda: fail})
    assert cli.main(["fail"]) == 1
    shown = capsys.readouterr().err
    assert len(shown) < 1_100
    assert shown.startswith("clothtrack: a.json: kind is x")
    assert shown.endswith("x; write towel\n")


def test_a_defect_of_ours_is_not_hidden(monkeypatch):
    fail = raising(ZeroDivisionError())
    monkeypatch.setattr(cli, "VERBS", {"fail": lambda: fail})
    with pytest.raises(ZeroDivisionError):
        cli.main(["fail"])


WITHOUT_THE_EXTRA = """
import importlib, pkgutil, sys
from importlib.machinery import PathFinder

EXTRA = ("torch", "safetensors", "skimage", "igl", "tensorboard")
find = PathFinder.find_spec

def find_others(name, path=None, target=None):
    return None if name.partition(".")[0] in EXTRA else find(name, path, target)

PathFinder.find_spec = find_others  # as if they were not installed
import clothtrack
for found in pkgutil.walk_packages(clothtrack.__path__, "clothtrack."):
    if not found.name.startswith(
        ("clothtrack.reconstruction", "clothtrack_lab.graph_dynamics")
    ):
        importlib.import_module(found.name)

from clothtrack.cli.command_line import main
for words in (
    ["label", "x.zarr", "--recordings", "x", "--output", "x"],
    ["pretrain", "x", "--output", "x"],
    ["finetune", "x", "x", "--output", "x"],
    ["reconstruct", "x.png"],
):
    print(main(words))
assert not set(EXTRA) & set(sys.modules)
"""


@pytest.mark.slow
def test_without_the_extra_all_but_learning_works_and_learning_says_what_it_needs():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_THE_EXTRA],
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    assert done.stdout.split() == ["1"] * 4
    lines = done.stderr.splitlines()
    assert len(lines) == 4
    for line in lines:
        assert "learning needs torch" in line
        assert line.endswith(install_command("learn"))


def test_track_lists_what_can_be_set_without_tracking(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["track", "--show-settings", "--set", "search.sweeps=3"]
    assert cli.main(words) == 0
    listed = capsys.readouterr().out.splitlines()
    assert any(line.startswith("search.sweeps=3    ") for line in listed)
    assert cli.main([*words, "a", "--output", "b"]) == 0
    assert cli.main(["flatten", "out", "--policy", "random", "--show-settings"]) == 0
    assert "policy=random" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def test_a_verb_computes_on_one_thread_unless_it_is_told_otherwise(monkeypatch, capsys):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    assert cli.main(["inspect", "nowhere"]) == 1
    capsys.readouterr()
    assert (os.environ["OMP_NUM_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]) == ("1", "3")
