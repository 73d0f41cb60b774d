"""Words of the verdict against the truth, and which states are drawn."""

import cv2
import numpy as np
import pytest
from shared.verdict_words import trusted_without
from tables import network_on_states
from tables.network_on_states import RIGHT, Sheet, State, named_best, trust_table

from clothtrack.garments import garment
from clothtrack.reconstruction.data.state_store import StateShard


def row(kind, word, share, **evidence):
    known = {"kind": kind, "weights": "a.safetensors", "word": word, "right": share <= RIGHT}
    return known | {"evidence": evidence or {"silhouette": word, "surface": "trust"}}


def test_the_trust_table_counts_what_is_right_by_kind_and_in_all():
    rows = [
        row("towel", "trust", 0.01), row("towel", "trust", 0.04), row("towel", "look", 0.03),
        row("tshirt", "trust", 0.2), row("tshirt", "reject", 0.3), {"error": "no cloth"},
    ]  # fmt: skip
    lines = trust_table(rows).splitlines()[2:5]
    towel, shirt, both = (line.split(" | ") for line in lines)
    assert [cell.strip(" |") for cell in towel[2:]] == ["3 of 3", "2 of 2", "1 of 1", "0 of 0"]
    assert [cell.strip(" |") for cell in shirt[2:]] == ["0 of 2", "0 of 1", "0 of 0", "0 of 1"]
    assert [cell.strip(" |") for cell in both[2:]] == ["3 of 5", "2 of 3", "1 of 1", "0 of 1"]


def test_without_an_evidence_more_is_trusted():
    rows = [
        row("towel", "trust", 0.01), row("towel", "look", 0.2, silhouette="look", surface="trust"),
        row("towel", "look", 0.02, silhouette="look", surface="look"),
    ]  # fmt: skip
    assert trusted_without(rows) == {
        "trust without silhouette: right": "1 of 2",
        "trust without surface: right": "1 of 1",
    }
    assert "- trust without silhouette: right 1 of 2" in trust_table(rows)


def test_the_look_alike_of_a_towel_has_no_error():
    flat = garment("towel", vertex_count=120, size_m=(0.3, 0.2))
    turned = flat.vertices * (-1.0, -1.0, 1.0)
    np.testing.assert_allclose(named_best(flat, turned, flat.vertices), flat.vertices, atol=1e-6)
    raised = flat.vertices + (0.0, 0.0, 0.01)
    np.testing.assert_allclose(named_best(flat, raised, flat.vertices), raised, atol=1e-6)


def test_the_sheet_keeps_the_worst_of_all_states(tmp_path):
    flat = garment("towel", vertex_count=120, size_m=(0.3, 0.2))
    lying = np.asarray(flat.vertices, np.float32)[None] + np.float32((0.0, 0.0, 0.0015))
    measures = {"coverage": np.ones(1), "speed": np.zeros(1), "strain": np.zeros(1)}
    measures["crossings"] = np.zeros(1)
    shard = StateShard("towel", flat, lying, np.zeros(1, int), ("flat",), 0, measures)
    case, file = State("towel", shard, 0, 0), tmp_path / "worst.png"
    assert case.known["size_m"] == pytest.approx(0.3)
    sheet = Sheet(file, 2)
    for error_mm in (10.0, 90.0, 30.0, 20.0):
        sheet.take(case, [case.true], case.known | {"error_mm": error_mm, "word": "look"})
    assert sheet.shares == pytest.approx([30.0, 10.0])
    picture = cv2.imread(str(file))
    Sheet(tmp_path / "one.png", 1).take(case, [case.true], case.known | {"error_mm": 90.0})
    assert picture.shape[0] == 2 * cv2.imread(str(tmp_path / "one.png")).shape[0]


def test_worst_without_a_picture_is_refused_in_one_line(tmp_path, capsys):
    words = ["--states", str(tmp_path), "--weights", "none", "--json", str(tmp_path / "out.json")]
    assert network_on_states.main([*words, "--worst", "3"]) == 2
    said = capsys.readouterr().err
    assert "--image" in said
    assert said.count("\n") == 1
