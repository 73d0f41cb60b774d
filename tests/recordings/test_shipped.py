"""What comes with clothtrack is small, valid, and found by its name."""

import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings import shipped
from clothtrack.recordings.inspection import inspect
from clothtrack.recordings.store import read_recording


def test_recordings_are_found_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(shipped, "SHIPPED", tmp_path)
    with pytest.raises(InvalidRecordingError, match="no recording comes"):
        shipped.shipped_recording()
    for name in ("b_shirt", "a_towel"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "recording.json").write_text("{}")
    assert shipped.shipped_recording().name == "a_towel"
    assert shipped.shipped_recording("b_shirt").name == "b_shirt"
    with pytest.raises(InvalidRecordingError, match="there are a_towel, b_shirt"):
        shipped.shipped_recording("c")


def test_what_is_shipped_is_small_and_whole():
    files = [path for path in shipped.SHIPPED.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 3e6
    assert inspect(shipped.shipped_recording()).valid


def test_the_demo_is_worth_looking_at_and_holds_no_truth():
    folder = shipped.shipped_recording()
    recording = read_recording(folder)
    assert recording.cloth.kind == "tshirt"
    assert len(recording.actions) >= 2
    assert "made_by" in recording.provenance
    kinds = {path.suffix for path in folder.rglob("*") if path.is_file()}
    assert kinds == {".png", ".csv", ".json", ".obj"}
    assert not list(folder.rglob("*truth*"))
