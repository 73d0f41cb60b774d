import errno
import os
import shutil

import pytest

from clothtrack.errors import StorageError
from clothtrack.files.atomic_write import (
    atomic_file,
    atomic_folder,
    clear_leftovers,
    hidden_name,
    name_problem,
    storage,
    write_file,
)


def _break_off(opened, path):
    with opened(path) as temporary:
        target = temporary / "part" if temporary.is_dir() else temporary
        target.write_text("half")
        raise RuntimeError("power cut")


@pytest.mark.parametrize("opened", [atomic_file, atomic_folder])
def test_nothing_appears_when_the_writer_fails(opened, tmp_path):
    with pytest.raises(RuntimeError):
        _break_off(opened, tmp_path / "result")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("opened", [atomic_file, atomic_folder])
def test_a_place_that_cannot_be_written_to_is_named(opened, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    path = tmp_path / "file" / "result"
    with pytest.raises(StorageError, match="file/result"), opened(path):
        pass


def test_a_finished_folder_replaces_the_one_before_when_it_is_to(tmp_path):
    path = tmp_path / "states.zarr"
    for words in ("yesterday", "today"):
        with atomic_folder(path, replace=True) as temporary:
            (temporary / words).touch()
    assert [found.name for found in path.iterdir()] == ["today"]
    assert [found.name for found in tmp_path.iterdir()] == ["states.zarr"]


def test_the_folder_before_stays_when_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    path = tmp_path / "states.zarr"
    with atomic_folder(path) as temporary:
        (temporary / "yesterday").touch()
    rename = os.replace

    def refused(source, target):
        if (source / "today").exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        rename(source, target)

    monkeypatch.setattr(os, "replace", refused)
    with (
        pytest.raises(StorageError, match="the disk is full"),
        atomic_folder(path, replace=True) as temporary,
    ):
        (temporary / "today").touch()
    assert [found.name for found in path.iterdir()] == ["yesterday"]
    assert [found.name for found in tmp_path.iterdir()] == ["states.zarr"]


def test_what_late_writers_keep_alive_is_removed_too(tmp_path, monkeypatch):
    """A writer that has not heard of the failure makes the first removals fail."""
    remove, calls = shutil.rmtree, []

    def fails_twice(folder, **options):
        calls.append(folder)
        if len(calls) > 2:
            remove(folder, **options)

    monkeypatch.setattr(shutil, "rmtree", fails_twice)
    with pytest.raises(RuntimeError):
        _break_off(atomic_folder, tmp_path / "result")
    assert len(calls) == 3
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "remedy"), [(errno.ENOSPC, "disk is full"), (errno.ENOTEMPTY, "in the way")]
)
def test_what_the_system_says_comes_with_a_remedy(number, remedy, tmp_path):
    with pytest.raises(StorageError, match=rf"result: .*{remedy}"), storage(tmp_path / "result"):
        raise OSError(number, "what the system says")


def test_a_disk_that_fills_up_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "picker.csv"
    write_file(path, b"old")

    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="the disk is full"):
        write_file(path, b"new")
    assert path.read_bytes() == b"old"
    assert [found.name for found in tmp_path.iterdir()] == ["picker.csv"]


@pytest.mark.parametrize("name", ["towel_0001", "my shirt", "größer.2", "x" * 200, "..."])
def test_a_plain_name_names_one_entry_of_a_folder(name):
    assert name_problem(name) == ""


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("", "empty"),
        (".", "a folder itself"),
        ("..", "a folder itself"),
        ("../x", "separator"),
        ("/x", "separator"),
        ("C:\\x", "separator"),
        ("a\0", "control"),
        ("a\x85b", "control"),
        ("x" * 201, "201 characters"),
        (7, "no text"),
        (None, "no text"),
    ],
)
def test_what_is_wrong_with_another_name_is_said(name, told):
    assert told in name_problem(name)


def left_by_a_killed_writer(path, suffix=""):
    """A hidden folder as a process leaves it when it is killed while it writes to a path."""
    left = path.with_name(hidden_name(path.name) + suffix)
    left.mkdir()
    (left / "big").touch()
    return left


def test_who_writes_a_folder_removes_what_a_killed_writer_of_it_has_left(tmp_path):
    path = tmp_path / "towel.zarr"
    left_by_a_killed_writer(path)
    neighbor = left_by_a_killed_writer(tmp_path / "towel.b.zarr")
    (tmp_path / ".towel.zarr.mine").touch()
    with atomic_folder(path):
        pass
    assert {one.name for one in tmp_path.iterdir()} == {
        path.name,
        neighbor.name,
        ".towel.zarr.mine",
    }


def test_unfinished_files_are_removed_by_who_holds_the_lock(tmp_path):
    (tmp_path / hidden_name("towel", ".mp4")).touch()
    clear_leftovers([tmp_path / "towel", tmp_path / "towel.mp4"])
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_being_replaced_gets_its_name_back(tmp_path):
    path = tmp_path / "towel.zarr"
    left_by_a_killed_writer(path, suffix=".old")
    clear_leftovers([path])
    assert [one.name for one in tmp_path.iterdir()] == ["towel.zarr"]
    assert (path / "big").exists()
