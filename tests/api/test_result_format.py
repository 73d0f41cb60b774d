"""docs/result_format.md names every array of a result, no more, no less; its snippets run."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import zarr

import clothtrack as ct

PAGE = (Path(__file__).parents[2] / "docs" / "result_format.md").read_text(encoding="utf-8")
ARRAY = re.compile(r"^\| `([\w/]+)` \| \((.*)\) \| (\w+) \| (\S*) ?\|", re.MULTILINE)
SNIPPETS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def section(title):
    return PAGE.partition(f"## {title}\n")[2].partition("\n## ")[0]


def attributes(title):
    return set(re.findall(r"^\| `(\w+)` \| ", section(title), re.MULTILINE))


@pytest.fixture(scope="module")
def calibrated(recording):
    """A run with a final alignment and candidates, so that no array is empty."""
    settings = "objective.iterations=1", "search.stop_score=0"
    return ct.track(recording, settings=settings)


@pytest.fixture(scope="module")
def stored(calibrated, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    calibrated.save(folder / "NAME.zarr")
    ct.export(calibrated, folder / "NAME.npz", "npz")
    return folder


def sizes(run):
    action = run.actions[0].calibration
    return {
        "frames": len(run.frames),
        "vertices": run.mesh.vertex_count,
        "faces": len(run.mesh.faces),
        "actions": len(run.actions),
        "candidates": len(action.candidates),
        "parameters": len(action.names),
    }


def described(title, run):
    """Shape, dtype and unit of every array in a section, with numbers for the names of axes."""
    known = sizes(run)
    return {
        name: (tuple(known.get(x) or int(x) for x in shape.replace(" ", "").split(",") if x),
               dtype, unit)
        for name, shape, dtype, unit in ARRAY.findall(section(title))
    }  # fmt: skip


def test_the_page_names_every_array_of_a_group(stored, calibrated):
    group = zarr.open_group(stored / "NAME.zarr", mode="r")
    found = {
        name.replace("actions/0/", "actions/K/"): (
            member.shape,
            str(member.dtype),
            member.attrs["unit"],
        )
        for name, member in group.members(max_depth=None)
        if isinstance(member, zarr.Array)
    }
    promised = described("Arrays of NAME.zarr", calibrated)
    scores = "actions/K/calibration_scores"
    # Its unit depends on the judge, as its line says.
    assert found.pop(scores)[:2] == promised.pop(scores)[:2]
    assert found == promised


def test_the_page_names_every_attribute(stored):
    group = zarr.open_group(stored / "NAME.zarr", mode="r")
    assert set(group.attrs) == attributes("Attributes of NAME.zarr")
    assert set(group["actions/0"].attrs) == attributes("Attributes of actions/K")


def test_the_page_names_every_array_of_an_archive(stored, calibrated):
    with np.load(stored / "NAME.npz", allow_pickle=False) as archive:
        found = {name: (archive[name].shape, str(archive[name].dtype)) for name in archive.files}
    promised = described("Arrays of an NPZ", calibrated)
    assert found == {name: one[:2] for name, one in promised.items()}


@pytest.mark.parametrize("snippet", SNIPPETS, ids=lambda text: text.splitlines()[-1])
def test_a_snippet_of_the_page_runs(snippet, stored):
    subprocess.run([sys.executable, "-c", snippet], cwd=stored, check=True, capture_output=True)


def test_there_is_a_snippet_with_and_without_clothtrack():
    assert ["clothtrack" in text.split("\n\n")[0] for text in SNIPPETS] == [True, False, False]
    assert all(len([line for line in text.splitlines() if line]) <= 5 for text in SNIPPETS)
