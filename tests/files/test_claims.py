"""Claims: one process has an item, a dead one loses it, a living one never does."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pytest

from clothtrack.errors import StorageError
from clothtrack.files import claims
from clothtrack.files.atomic_write import (
    atomic_file,
    atomic_folder,
    clear_dead,
    clear_leftovers,
)
from clothtrack.files.claims import LEASE_S, claimed, holder_of, locked
from clothtrack.files.owner import Owner, hidden_name, hidden_parts

HOLD = """
import sys, time
from pathlib import Path
from clothtrack.files.claims import claimed
with claimed(Path(sys.argv[1]), "towel") as mine:
    print(mine, flush=True)
    time.sleep(120)
"""


@contextmanager
def other_process(folder: Path):
    """Another process that holds the claim to "towel"."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout.readline() == "True\n"
            yield process
        finally:
            process.kill()


def elsewhere(folder: Path, name: str, age_s: float) -> Path:
    """A claim that another machine has renewed so long ago."""
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.0"
    owner = {"host": "node17", "machine": "00000000", "pid": 12, "start": 34}
    path.write_text(json.dumps({**owner, "since": 0.0, "token": "x"}))
    os.utime(path, (time.time() - age_s,) * 2)
    return path


def test_one_process_has_a_claim_until_it_is_killed(tmp_path):
    with other_process(tmp_path) as process:
        with claimed(tmp_path, "towel") as mine, claimed(tmp_path, "shirt") as another:
            assert (mine, another) == (False, True)
        holder = holder_of(tmp_path, "towel")
        assert (holder.owner.pid, holder.lives) == (process.pid, True)
        process.kill()
        process.wait()
        assert not holder_of(tmp_path, "towel").lives
        with claimed(tmp_path, "towel") as mine:
            assert mine
            assert holder_of(tmp_path, "towel").owner == Owner.me()
    assert holder_of(tmp_path, "towel") is None
    assert list(tmp_path.iterdir()) == []


def test_a_stopped_process_of_this_machine_keeps_its_claim(tmp_path):
    with other_process(tmp_path) as process:
        process.send_signal(signal.SIGSTOP)
        (path,) = tmp_path.iterdir()
        os.utime(path, (0.0, 0.0))
        with claimed(tmp_path, "towel") as mine:
            assert not mine


def test_a_number_that_was_given_again_is_another_process(tmp_path):
    with claimed(tmp_path, "towel") as mine:
        assert mine
        (path,) = tmp_path.iterdir()
        document = json.loads(path.read_text())
        path.write_text(json.dumps({**document, "start": document["start"] - 1}))
        assert not holder_of(tmp_path, "towel").lives


@pytest.mark.parametrize(("age_s", "taken"), [(0.5 * LEASE_S, False), (2.0 * LEASE_S, True)])
def test_a_claim_of_another_machine_lasts_for_its_lease(tmp_path, age_s, taken):
    path = elsewhere(tmp_path, "towel", age_s)
    with claimed(tmp_path, "towel") as mine:
        assert mine is taken
        assert path.exists() is not taken


def test_a_claim_is_renewed_while_it_is_held(tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "RENEW_S", 0.02)
    with claimed(tmp_path, "towel"):
        (path,) = tmp_path.iterdir()
        os.utime(path, (0.0, 0.0))
        end = time.monotonic() + 30.0
        while path.stat().st_mtime < 1.0:
            assert time.monotonic() < end
            time.sleep(0.01)


def test_who_judged_a_claim_too_early_does_not_get_the_next_one(tmp_path, monkeypatch):
    """Another process takes the dead claim over, and is done, while we make up our mind."""
    path = elsewhere(tmp_path, "towel", 2.0 * LEASE_S)
    text = path.read_text().replace('"x"', '"y"')

    def slowly(*_) -> bool:
        path.write_text(text)
        return False

    monkeypatch.setattr(claims, "_lives", slowly)
    with claimed(tmp_path, "towel") as mine:
        assert not mine
    assert path.read_text() == text
    assert list(tmp_path.iterdir()) == [path]


def race(folder: Path, name: str, times: int) -> None:
    """Take a claim so many times; whoever has it is alone with it."""
    taken = 0
    while taken < times:
        with claimed(folder / "claims", name) as mine:
            if mine:
                taken += 1
                (folder / "alone").mkdir()
                (folder / "alone").rmdir()
                with (folder / "taken").open("a") as file:
                    file.write("x")


def add(folder: Path, name: str, times: int) -> None:
    for number in range(times):
        with locked(folder / "claims", "list"):
            path = folder / "list.json"
            listed = json.loads(path.read_text()) if path.exists() else []
            with atomic_file(path) as unfinished:
                unfinished.write_text(json.dumps([*listed, f"{name}{number}"]))


@pytest.mark.parametrize("task", [race, add])
def test_four_processes_at_once(tmp_path, task):
    names = ["same"] * 4 if task is race else list("abcd")
    processes = [
        get_context("spawn").Process(target=task, args=(tmp_path, name, 40)) for name in names
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0] * 4
    if task is race:
        assert (tmp_path / "taken").stat().st_size == 4 * 40
    else:
        assert len(set(json.loads((tmp_path / "list.json").read_text()))) == 4 * 40
    assert list((tmp_path / "claims").iterdir()) == []


def leave(path: Path, owner: Owner) -> Path:
    """A hidden folder as the owner leaves it when it is killed."""
    parts = hidden_parts(hidden_name(path.name, ".partial"))
    assert parts == (path.name, replace(Owner.me(), host=""), ".partial")
    mark = f"{owner.machine}-{owner.pid}-{owner.start}-01234567"
    left = path.with_name(f".{path.name}.{mark}.partial")
    left.mkdir()
    (left / "big").touch()
    return left


def test_what_dead_processes_leave_is_removed_and_nothing_of_a_living_one(tmp_path):
    me = Owner.me()
    dead = Owner("", me.machine, me.pid, me.start - 1)
    far = Owner("", "00000000", 1, 1)
    kept = [leave(tmp_path / "towel", me), leave(tmp_path / "towel.b", far)]
    (tmp_path / ".towel.mine").touch()
    far_left = leave(tmp_path / "towel", far)
    for clear in (lambda: clear_leftovers(tmp_path / "towel"), lambda: clear_dead([tmp_path])):
        left = leave(tmp_path / "towel", dead)
        clear()
        assert not left.exists()
        assert far_left.exists()
    clear_leftovers(tmp_path / "towel", claimed=True)
    assert not far_left.exists()
    assert all(path.exists() for path in (*kept, tmp_path / ".towel.mine"))


def test_a_folder_that_was_being_replaced_gets_its_name_back(tmp_path):
    me = Owner.me()
    old = tmp_path / f".towel.zarr.{me.machine}-{me.pid}-{me.start - 1}-01234567.old"
    old.mkdir()
    (old / "yesterday").touch()
    clear_leftovers(tmp_path / "towel.zarr")
    assert [path.name for path in tmp_path.iterdir()] == ["towel.zarr"]
    assert (tmp_path / "towel.zarr" / "yesterday").exists()


def test_a_full_disk_leaves_no_claim_without_an_owner(tmp_path):
    """Its name takes no room, its content does: others would wait for a machine that is none."""
    with claimed(tmp_path, "earlier"):
        pass
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        with pytest.raises(StorageError), claimed(tmp_path, "towel"):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_who_writes_into_a_folder_first_removes_what_dead_processes_left_there(tmp_path, kind):
    """Verbs with one result have no list of work that would do so."""
    me = Owner.me()
    names = {
        pid: f".sheet.{me.machine}-{me.pid}-{start}-00000000.png"
        for pid, start in (("dead", me.start - 1), ("alive", me.start))
    }
    for name in names.values():
        (tmp_path / name).touch()
    writer = atomic_file(tmp_path / "new") if kind == "file" else atomic_folder(tmp_path / "new")
    with writer:
        pass
    assert {path.name for path in tmp_path.iterdir()} == {"new", names["alive"]}


def test_what_a_dead_process_left_while_it_claimed_is_removed(tmp_path):
    code = "from clothtrack.files.owner import hidden_name; print(hidden_name('now'))"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    (tmp_path / told.stdout.strip()).touch()
    living = tmp_path / hidden_name("now")
    living.touch()
    claims.clear_dead_claims(tmp_path)
    assert list(tmp_path.iterdir()) == [living]
