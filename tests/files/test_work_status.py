"""What is told of the work in a folder whose memory somebody has damaged."""

import json

import pytest

from clothtrack.files.work_folder import WorkFolder
from clothtrack.files.work_status import work_status


@pytest.fixture
def folder(tmp_path):
    work = WorkFolder(tmp_path, "track")
    work.ask("track a b", {"a": tmp_path / "a.zarr", "b": tmp_path / "b.zarr"})
    work.note_done("a", 3.5)
    (tmp_path / "a.zarr").mkdir()
    return work


@pytest.mark.parametrize(
    "change",
    [
        {"command": 3}, {"command": None}, {"items": []}, {"items": {"a": 3}},
        {"items": {"a": "\0"}},
    ],
)  # fmt: skip
def test_what_was_asked_for_in_a_damaged_file_was_not(folder, tmp_path, change):
    (path,) = (folder.folder / "asked").iterdir()
    document = json.loads(path.read_text())
    path.with_name("0.json").write_text(json.dumps({**document, **change}))
    path.with_name("1.json").write_text("[" * 5000)
    (verb,) = work_status(tmp_path)
    assert [item.state for item in verb.items] == ["done", "not begun"]
    assert verb.command == "track a b"


@pytest.mark.parametrize(
    "change",
    [{"seconds": "x"}, {"pid": []}, {"pid": float("nan")}, {"host": 3}, {"seconds": 10**400}],
)
def test_a_damaged_note_of_an_item_says_less(folder, tmp_path, change):
    path = folder.folder / "items" / "a.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    (verb,) = work_status(tmp_path)
    (item,) = verb.of("done")
    assert item.seconds in (3.5, None)
    assert verb.left_s is None or verb.left_s == pytest.approx(3.5)
