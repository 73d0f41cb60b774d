"""One command starts every experiment, and the index names them all with options that exist."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
SCRIPTS = {
    file.stem: f"{folder}.{file.stem}"
    for folder in ("tables", "figures", "real")
    for file in sorted((EXPERIMENTS / folder).glob("[!_]*.py"))
    if "\ndef main(" in file.read_text("utf-8")
}
LINES = re.findall(
    r"^\| `(\w+)`( \(s\))? \| .+ \| `(\w+) (.+)` \|$",
    (EXPERIMENTS / "README.md").read_text("utf-8"),
    re.MULTILINE,
)


def started(*words, cwd):
    command = [sys.executable, str(EXPERIMENTS), *words]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


def test_the_index_has_a_line_for_every_script():
    assert sorted(name for name, *_ in LINES) == sorted(SCRIPTS)
    assert all(name == command for name, _, command, _ in LINES)


@pytest.mark.parametrize(("name", "smoke", "options"), [(n, s, o) for n, s, _, o in LINES])
def test_the_options_of_the_index_exist(name, smoke, options, monkeypatch, capsys):
    module = importlib.import_module(SCRIPTS[name])
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit, match="0"):
        module.main()
    text = capsys.readouterr().out
    for option in re.findall(r"--[\w-]+", options):
        assert option in text
    assert ("--smoke" in text) == bool(smoke)


@pytest.mark.parametrize(("name", "module"), [("table1", "mujoco"), ("table2_real", "skimage")])
def test_a_missing_extra_is_named_in_one_line(tmp_path, name, module):
    code = (
        f"import runpy, sys; sys.modules[{module!r}] = None; "
        f"sys.argv = ['experiments', {name!r}, '--help']; runpy.run_path({str(EXPERIMENTS)!r}, "
        "run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"experiments {name} needs {module}, ")
    assert "[experiments]" in done.stderr or "EXTRAS=experiments" in done.stderr


def test_an_experiment_starts_from_any_folder(tmp_path):
    done = started("tables", "--rows", "nothing", cwd=tmp_path)
    assert done.returncode == 1
    assert "no rows of any experiment" in done.stdout + done.stderr
    listed = started(cwd=tmp_path)
    assert listed.returncode == 0
    assert "`table1`" in listed.stdout
    unknown = started("table9", cwd=tmp_path)
    assert unknown.returncode == 2
    assert "'table9'" in unknown.stderr
