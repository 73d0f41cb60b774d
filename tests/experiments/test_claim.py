"""The claim: cells are kept and shared, differences are paired, and chance is not made small."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra [learn] brings it")

from shared import claim_table
from shared.bench_runs import read_rows
from shared.unkind_world import GARMENTS, HELD_OUT_SEED, LEARNED_SEED, film, unkind
from tables import claim

from clothtrack_lab.published_networks.canonical_frame import check_canonical
from clothtrack_lab.world.one_garment import OneGarment


@pytest.mark.slow
def test_the_claim_runs_and_a_second_call_makes_nothing(tmp_path, capsys):
    words = ["--smoke", "--out", str(tmp_path)]
    assert claim.main(words) == 0
    first = capsys.readouterr()
    rows = read_rows(tmp_path / claim.ROWS)
    assert {row["variant"] for row in rows} == {*claim.LABELS, "error 5 mm"}
    assert not [row for row in rows if "error" in row]
    by_label = {row["variant"]: row["label_error_mm"] for row in rows}
    assert by_label["before"] is None
    assert by_label["truth"] == by_label["usual"] == 0.0
    assert by_label["error 5 mm"] == 5.0
    assert 0.0 < by_label["default"] < by_label["open_loop"]
    kept = {one: one.stat().st_mtime_ns for one in (tmp_path / "networks").rglob("*.*")}
    assert claim.main(words) == 0
    assert {one: one.stat().st_mtime_ns for one in (tmp_path / "networks").rglob("*.*")} == kept
    assert capsys.readouterr().out == first.out
    # What is finished is printed without anything else.
    assert claim.main(["--out", str(tmp_path), "--only-print"]) == 0
    assert capsys.readouterr().out in first.out


@pytest.mark.slow
def test_a_recording_is_not_learned_from_and_measured_on(tmp_path, capsys):
    asked = claim.Claim(tmp_path, 1, 1, smoke=True)
    (learned,) = asked.learned("towel")
    (measured,) = asked.measured("towel")
    assert measured.name == f"towel_{HELD_OUT_SEED:04d}"
    for name in ("000003.png", "000004.png"):
        shown = learned.recording / "depth" / name
        (measured.recording / "depth" / name).write_bytes(shown.read_bytes())
    with pytest.raises(claim.ClothTrackError, match="show the same pictures"):
        asked.rows(claim.Cell("towel", "published", "truth", 0))


@pytest.mark.slow
def test_more_recordings_to_learn_from_leave_the_others_as_they_are(tmp_path):
    garment = GARMENTS["towel"]
    one = film(tmp_path / "a", garment, 1, LEARNED_SEED, smoke=True)
    two = film(tmp_path / "a", garment, 2, LEARNED_SEED, smoke=True)
    assert two[0] == one[0]
    assert len(two) == 2


def test_the_world_is_unkind_and_else_the_garments_own():
    for garment in GARMENTS.values():
        usual, config = garment.config, unkind(garment)
        assert 0.3 < config.slips + config.action.both_layers < 0.35
        assert config.picker_bias_m > usual.picker_bias_m
        assert config.fabric.young_pa > usual.fabric.young_pa
        assert config.fabric.table_friction < usual.fabric.table_friction
        assert replace(config.fabric, **{
            name: getattr(usual.fabric, name)
            for name in ("young_pa", "table_friction", "cloth_friction")
        }) == usual.fabric  # fmt: skip
        assert config.sensor == usual.sensor
        flat = garment.flat(vertex_count=300)
        check_canonical(np.asarray(flat.canonical), garment.kind)
    assert GARMENTS["sweater"].label != GARMENTS["tshirt"].label
    with pytest.raises(claim.ClothTrackError, match="a sweater is a tshirt"):
        OneGarment("towel", 1, sweater=True)


def row(labels, recording, seed, error, **changes):
    return {
        "garment": "tshirt", "network": "tokens", "recordings": 2, "held_out": 2,
        "variant": labels, "recording": recording, "seed": seed, "label_error_mm": 1.0,
        "has_mesh": 1.0, "error_symmetric_mm": error, "error_symmetric_visible_mm": error,
        "error_symmetric_hidden_mm": error, "chamfer_pc_m2": 1e-4, **changes,
    }  # fmt: skip


def test_differences_are_paired_by_recording_and_by_seed_where_there_are_seeds():
    rows = [
        row("before", "a", 0, 10.0), row("before", "b", 0, 20.0),
        row("open_loop", "a", 0, 8.0), row("open_loop", "b", 0, 18.0),
        row("open_loop", "a", 1, 6.0), row("open_loop", "b", 1, 16.0),
        row("default", "a", 0, 5.0), row("default", "b", 0, 15.0),
        row("default", "a", 1, 3.0), row("default", "b", 1, 13.0),
        row("default", "c", 1, 99.0),
    ]  # fmt: skip
    text = claim_table.of_one([one for one in rows if one["recording"] != "c"])
    default = next(line for line in text.splitlines() if line.startswith("| default"))
    cells = [cell.strip() for cell in default.strip("|").split("|")]
    by_head = dict(zip(claim_table.HEAD, cells, strict=True))
    # Against open loop, 3 mm less in each recording and seed: no chance is left.
    assert by_head["minus open_loop"] == "-3.0 ± 0.0 (4 of 4)"
    # What has not learned has no seed: -5 and -7, whose mean over two seeds is 1 mm uncertain.
    assert by_head["minus before"] == "-6.0 ± 1.0 (4 of 4)"
    assert by_head["minus truth"] == "-"
    assert by_head["over before"] == "0.60"
    assert by_head["trainings"] == "2"


def test_another_training_is_no_pair():
    rows = [row("truth", "a", 0, 10.0), row("default", "a", 0, 11.0), row("default", "a", 1, 99.0)]
    assert "+1.0 ± 0.0 (0 of 1)" in claim_table.of_one(rows)


def test_a_recording_that_the_other_lacks_is_not_compared():
    rows = [row("before", "a", 0, 10.0), row("default", "a", 0, 5.0), row("default", "c", 0, 99.0)]
    assert "-5.0 ± 0.0 (1 of 1)" in claim_table.of_one(rows)


def test_the_standard_error_is_that_of_recordings_and_of_seeds():
    # Of 400 draws with an effect of each recording and of each seed, the spread of the mean.
    rng = np.random.default_rng(0)
    means, said = [], []
    for _ in range(400):
        of_recordings, of_seeds = rng.normal(0, 2, 5), rng.normal(0, 1, 3)
        of = {
            (str(recording), seed): of_recordings[recording] + of_seeds[seed] + rng.normal(0, 0.5)
            for recording in range(5)
            for seed in range(3)
        }
        means.append(np.mean(list(of.values())))
        said.append(claim_table.standard_error(of))
    assert np.sqrt(np.mean(np.square(said))) == pytest.approx(np.std(means), rel=0.15)
    with_one_seed = {("a", 0): 1.0, ("b", 0): 3.0}
    assert claim_table.standard_error(with_one_seed) == pytest.approx(1.0)


def test_rows_of_a_cell_take_the_place_of_older_ones(tmp_path):
    file = tmp_path / claim.ROWS
    claim.keep([row("default", "a", 0, 5.0), row("default", "b", 0, 5.0)], file)
    claim.keep([row("default", "a", 1, 6.0)], file)
    claim.keep([row("default", "a", 0, 7.0)], file)
    claim.keep([row("default", "a", 0, 9.0, recordings=3)], file)
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert sorted(one["error_symmetric_mm"] for one in rows) == [6.0, 7.0, 9.0]
    text = claim_table.markdown(rows)
    assert text.count("## tshirt") == 2


def test_what_has_not_learned_is_measured_once():
    options = claim.argparse.Namespace(
        labels=["before", "truth"], label_error=[2.0], seeds=[3, 4], garments=["tshirt"],
        networks=["tokens"],
    )  # fmt: skip
    found = [(cell.labels, cell.seed) for cell in claim.cells(options)]
    assert found == [
        ("before", 0), ("truth", 3), ("error 2 mm", 3), ("truth", 4), ("error 2 mm", 4)
    ]  # fmt: skip
