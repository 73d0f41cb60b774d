"""One command starts every experiment, the index names them all, and their small forms run."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from shared import tables

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


SMOKES = [name for name, small, *_ in LINES if small and name != "same_bits"]
"""`same_bits` runs two checkouts, for minutes."""

NEEDS = {
    "torch": (
        "table1", "network_alone", "table2_real", "leave_one_out", "real_pictures", "train_on",
        "flattening", "planning_choices",
    ),
    "biocpd": ("model_free",),
}  # fmt: skip
MORE = {
    "train_on": ("--garments", "towel"),
    "table2_real": ("--networks", "published", "--labels", "none", "default"),
    "leave_one_out": ("--labels", "none", "default"),
    "real_recordings": ("--data", "nothing"),
}
"""Options without which a small form does more than show that it runs."""

MEASURES = ("error_all_mm", "chamfer_pc_m2", "edge_strain", "crossings", "cpu_s")


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """One towel, filmed and tracked once for all experiments over the benchmark."""
    return tmp_path_factory.mktemp("bench")


@pytest.mark.slow
@pytest.mark.parametrize("name", SMOKES)
def test_a_smoke_ends_with_rows_and_a_table(name, bench, tmp_path, capsys):
    for module, names in NEEDS.items():
        if name in names:
            pytest.importorskip(module)
    main = importlib.import_module(SCRIPTS[name]).main
    given = next(text for one, _, _, text in LINES if one == name)
    places = {"--bench": bench, "--output": tmp_path, "--json": tmp_path / "rows.json"}
    (place,) = [one for one in places if one in given] or ["--out"]
    words = ["--smoke", place, places.get(place, tmp_path), *MORE.get(name, ())]
    assert main(list(map(str, words))) == 0
    printed = capsys.readouterr().out
    if name in tables.TITLES and name != "flattening":
        lines = (bench / "experiments" / f"{name}.jsonl").read_text().splitlines()
        rows = [json.loads(line) for line in lines]
        assert tables.markdown(name, rows) in printed
        assert not [row["error"] for row in rows if "error" in row]
        assert all(row["experiment"] == name and "provenance" in row for row in rows)
        if name != "network_alone":
            assert all(row[key] is not None for row in rows for key in MEASURES)
    else:
        assert any(one.stat().st_size for one in tmp_path.rglob("*.json*"))
        assert name == "real_recordings" or "|" in printed or "pictures" in printed
