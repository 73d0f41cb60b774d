"""Every experiment runs in its small form, writes its rows and prints its table."""

import importlib
import json

import pytest
from shared import tables
from test_index import LINES, SCRIPTS

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
