"""What `inspect` says of a good and of a broken recording."""

import json
from dataclasses import replace

import pytest

from clothtrack.recordings.inspection import inspect


def test_a_valid_recording_is_described(write, tmp_path):
    write(tmp_path / "fold")
    inspection = inspect(tmp_path / "fold")
    assert inspection.valid
    text = inspection.text()
    for words in (
        "a valid recording",
        "5, from 0 to 2 s",
        "color, depth, masks",
        "64 x 48, fx 60.0, at (0.000 0.000 0.600) m",
        "2: 0-2 by arm, 2-4 by arm",
        "towel, blue, 0.1 x 0.1 m, template of 4 vertices, held by arm",
        "frame 0 shows",
    ):
        assert words in text
    json.dumps(inspection.as_dict(), allow_nan=False)


def test_every_violation_is_listed_for_people_and_programs(write, tmp_path):
    write(tmp_path / "fold")
    for frame in (1, 3):
        (tmp_path / f"fold/depth/{frame:06d}.png").unlink()
    inspection = inspect(tmp_path / "fold")
    assert not inspection.valid
    assert "2 things to correct" in inspection.text()
    content = json.loads(json.dumps(inspection.as_dict()))
    assert [found["file"] for found in content["violations"]] == [
        "depth/000001.png",
        "depth/000003.png",
    ]
    assert all(found["problem"] and found["remedy"] for found in content["violations"])


def test_a_thousand_violations_do_not_flood_the_screen(write, edit, tmp_path):
    write(tmp_path / "fold")
    edit(tmp_path / "fold", lambda document: document.pop("frames"))
    inspection = inspect(tmp_path / "fold")
    (one,) = inspection.violations
    # Causes that are alike are one line, whatever their number; these are not.
    many = [replace(one, problem=f"wrong {'so ' * number}") for number in range(1000)]
    inspection = replace(inspection, violations=tuple(many))
    assert len(inspection.text().splitlines()) == 22
    assert "more" in inspection.text().splitlines()[-1]


@pytest.mark.parametrize(
    ("kind", "told"),
    [("tshirt", "calibrate-camera"), ("other", "cloth.kind is 'other'")],
)
def test_a_table_that_is_not_known_yet_is_no_cloth_that_hangs(write, edit, tmp_path, kind, told):
    write(tmp_path / "imported")

    def as_imported(document):
        document["table"] = None
        document["cloth"] = {"kind": kind}

    edit(tmp_path / "imported", as_imported)
    inspection = inspect(tmp_path / "imported")
    assert inspection.valid
    assert "hangs" not in inspection.text()
    assert "calibrate-camera" in inspection.facts["table"]
    (note,) = [note for note in inspection.notes if "no template" in note]
    assert told in note
    assert f"this is {kind!r}" not in note


def test_a_cloth_with_a_template_and_no_table_hangs(write, edit, tmp_path):
    write(tmp_path / "held")
    edit(tmp_path / "held", lambda document: document.update(table=None))
    assert inspect(tmp_path / "held").facts["table"] == "none: the cloth hangs"


def test_one_cause_in_many_files_is_one_line(write, tmp_path):
    write(tmp_path / "fold")
    for frame in range(5):
        (tmp_path / f"fold/depth/{frame:06d}.png").unlink()
    (tmp_path / "fold/mask/000002.png").write_bytes(b"no picture")
    inspection = inspect(tmp_path / "fold")
    head, depth, mask = inspection.text().splitlines()
    assert head.endswith("6 things to correct")
    assert depth.startswith("  - 5 alike, the first: depth/000000.png: ")
    assert mask.startswith("  - mask/000002.png: ")
    assert len(inspection.as_dict()["violations"]) == 6
