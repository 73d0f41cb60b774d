"""No picture of the fabric that is judged is learned from, whatever its takes are called."""

import json
from types import SimpleNamespace

import pytest
from real import leave_one_out
from real.leave_one_out import fabric_of, other_fabrics, same_fabric, tables

from clothtrack.errors import InvalidConfigError

NAMES = ("fold_navy", "fold_navy2", "lift_navy2", "lift_paper", "lift_tan", "lift_tan2")


def sequences(*names):
    # Distinct clouds: `refuse_shared` compares them.
    return [
        SimpleNamespace(
            name=name, file=name, sequence=SimpleNamespace(clouds=[[[float(number), 0.0, 0.0]]])
        )
        for number, name in enumerate(names)
    ]


def test_all_takes_of_a_fabric_are_left_out_together():
    parts = other_fabrics(sequences(*NAMES))
    assert list(parts) == ["navy", "paper", "tan"]
    for fabric, splits in parts.items():
        judged = {one.name for one in splits["left out"]}
        assert judged == {name for name in NAMES if fabric_of(name) == fabric}
        assert {one.name for one in splits["train"]} == set(NAMES) - judged
    assert {one.name for one in parts["tan"]["left out"]} == {"lift_tan", "lift_tan2"}


def test_one_fabric_alone_or_one_take_under_two_names_is_refused():
    with pytest.raises(InvalidConfigError, match="one fabric"):
        other_fabrics(sequences("fold_navy", "lift_navy2"))
    twice = sequences("fold_navy", "lift_tan")
    twice[1].sequence = twice[0].sequence
    with pytest.raises(InvalidConfigError, match="learned from"):
        other_fabrics(twice)


def test_the_same_fabric_teaches_each_of_its_sequences():
    parts = same_fabric(sequences("fold_navy", "lift_navy2", "lift_tan", "lift_tan2", "fold_tan"))
    learned = {name: [one.name for one in splits["train"]] for name, splits in parts.items()}
    assert learned["fold_navy"] == ["lift_navy2"]
    assert learned["lift_tan2"] == ["lift_tan", "fold_tan"]
    assert all([one.name for one in parts[name]["left out"]] == [name] for name in learned)
    with pytest.raises(InvalidConfigError, match="lift_paper is the only sequence"):
        same_fabric(sequences(*NAMES))


def test_pictures_are_compared_with_themselves_before():
    def row(labels, sequence, frame, chamfer):
        return {"network": "tokens", "labels": labels, "sequence": sequence, "frame": frame,
                "chamfer_pc_m2": chamfer, "corner_mm": 10.0}  # fmt: skip

    rows = [
        row("none", "lift_a", 6, 4e-4), row("none", "lift_a", 7, 2e-4),
        row("none", "lift_b", 6, 1e-4),
        row("default", "lift_a", 6, 1e-4), row("default", "lift_a", 7, 3e-4),
        row("default", "lift_b", 6, None),
    ]  # fmt: skip
    text = tables(rows)
    # A picture without a mesh is not nearer, and it counts.
    assert "| default | 3 | 2.0 | 2.0 | - | - | 10.0 | 10.0 | - | - | 1 of 3 |" in text
    assert "| default | 2.0 | - |" in text
    assert "| none | 3.0 | 1.0 |" in text


@pytest.mark.slow
def test_it_runs_on_drawn_clouds_and_judges_every_sequence_once(tmp_path, capsys):
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    words = ["--smoke", "--json", str(tmp_path / "rows.json"), "--labels", "none", "default"]
    assert leave_one_out.main(words) == 0
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    for labels in ("none", "default", "tracker"):
        own = [(row["sequence"], row["frame"]) for row in rows if row["labels"] == labels]
        assert len(own) == len(set(own)) == 9
        assert len({sequence for sequence, _ in own}) == 3
    assert tables(rows) in capsys.readouterr().out
