"""Work that several processes share: done once, whole, and by whoever is still alive."""

import os
import signal
import subprocess
import sys
import time
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from clothtrack.errors import ClothTrackError, InvalidConfigError, SimulationDivergedError
from clothtrack.files.atomic_write import write_file
from clothtrack.files.shared_work import Share, attempts, results_of
from clothtrack.files.work_folder import WorkFolder

NAMES = [f"item_{number}" for number in range(8)]


@dataclass(frozen=True)
class Writing:
    """Writes a file for each name, and notes in `made` that it has."""

    out: Path
    pause_s: float = 0.0

    def name(self, item: str) -> str:
        return item

    def paths(self, item: str) -> list[Path]:
        return [self.out / f"{item}.txt"]

    def kept(self, item: str) -> str | None:
        (path,) = self.paths(item)
        return path.read_text() if path.exists() else None

    def do(self, item: str) -> str:
        with (self.out / "made").open("a") as file:
            file.write(f"{item}\n")
        time.sleep(self.pause_s)
        if item.startswith("bad"):
            raise SimulationDivergedError(f"{item} diverges")
        if item.startswith("deadly"):
            os.kill(os.getpid(), signal.SIGKILL)
        write_file(self.paths(item)[0], item.upper().encode())
        return item.upper()


def run(out: Path, names=NAMES, *, pause_s=0.0, **options):
    folder = WorkFolder(out, "track")
    with closing(attempts(Writing(out, pause_s), names, folder, kind="items", **options)) as tries:
        return list(tries)


def made(out: Path) -> list[str]:
    return sorted((out / "made").read_text().split())


SCRIPT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_shared_work import run
if __name__ == "__main__":
    tries = run(Path(sys.argv[2]), pause_s=float(sys.argv[3]), processes=int(sys.argv[4]))
    print(sorted(one.result for one in tries))
"""


@pytest.fixture
def started(tmp_path):
    """Starts processes on one folder; nothing of them is left after the test."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    processes = []

    def start(pause_s: float, workers: int = 1) -> subprocess.Popen:
        words = [sys.executable, script, Path(__file__).parent, tmp_path / "out", pause_s, workers]
        processes.append(
            subprocess.Popen(
                list(map(str, words)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                start_new_session=True,
            )
        )  # fmt: skip
        return processes[-1]

    (tmp_path / "out").mkdir()
    yield start
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.mark.parametrize(("count", "workers"), [(2, 1), (4, 1), (2, 2)])
def test_several_processes_finish_the_work_once(started, tmp_path, count, workers):
    processes = [started(0.1, workers) for _ in range(count)]
    for process in processes:
        said, complained = process.communicate(timeout=120)
        assert process.returncode == 0, complained
        # Everybody ends when all is there.
        assert said == f"{[name.upper() for name in NAMES]}\n"
    assert made(tmp_path / "out") == NAMES
    assert list((tmp_path / "out" / ".work" / "track" / "claims").iterdir()) == []


def test_the_item_of_a_killed_process_is_taken_over(started, tmp_path):
    first = started(600.0)
    while not (tmp_path / "out" / "made").exists():
        assert first.poll() is None
        time.sleep(0.02)
    second = started(0.0)
    while len(list((tmp_path / "out").glob("*.txt"))) < len(NAMES) - 1:
        assert second.poll() is None
        time.sleep(0.02)
    time.sleep(0.5)
    assert second.poll() is None, "what the other one holds is waited for"
    first.kill()
    first.wait()
    said, complained = second.communicate(timeout=60)
    assert second.returncode == 0, complained
    assert said == f"{[name.upper() for name in NAMES]}\n"
    assert made(tmp_path / "out") == sorted([*NAMES, NAMES[0]])


def test_a_killed_worker_costs_its_own_item(tmp_path):
    tries = run(tmp_path, ["deadly", *NAMES], processes=2)
    by_name = {one.item: one for one in tries}
    assert [by_name[name].result for name in NAMES] == [name.upper() for name in NAMES]
    assert "killed" in str(by_name["deadly"].error)
    assert WorkFolder(tmp_path, "track").record("deadly")["status"] == "failed"
    assert WorkFolder(tmp_path, "track").holder("deadly") is None


def test_what_is_finished_is_kept_and_what_failed_is_tried_again(tmp_path):
    seen = []
    names = ["bad", *NAMES[:2]]
    tries = run(tmp_path, names, progress=lambda *told: seen.append(told))
    assert [str(one.error) for one in tries] == ["bad diverges", "None", "None"]
    assert [done for _, done, _ in seen] == [0, 1, 2, 3]
    record = WorkFolder(tmp_path, "track").record("bad")
    assert (record["status"], record["error"]) == ("failed", "bad diverges")
    again = run(tmp_path, names)
    assert [one.kept for one in again] == [False, True, True]
    assert made(tmp_path) == sorted(["bad", "bad", *NAMES[:2]])


def test_what_a_neighbour_has_just_failed_at_is_not_tried_twice(tmp_path):
    """The neighbour fails after this process has begun, before it comes to the item."""
    names = ["first", "bad"]
    folder = WorkFolder(tmp_path, "track")
    with closing(attempts(Writing(tmp_path), names, folder, kind="items")) as tries:
        next(tries)
        folder.note_failed("bad", SimulationDivergedError("the neighbour says so"))
        (other,) = tries
    assert isinstance(other.error, SimulationDivergedError)
    assert "neighbour" in str(other.error)
    assert made(tmp_path) == ["first"]


def test_an_error_is_raised_after_all_others(tmp_path):
    results = results_of(iter(run(tmp_path, ["bad", *NAMES])))
    assert [next(results) for _ in NAMES] == [(name, name.upper()) for name in NAMES]
    with pytest.raises(ClothTrackError, match="bad diverges"):
        next(results)


def test_shares_are_disjoint_and_whole(tmp_path):
    parts = [Share.parse(f"{number}/3").of(NAMES) for number in (1, 2, 3)]
    assert sorted(name for part in parts for name in part) == NAMES
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    assert Share.parse("").of(NAMES) == NAMES
    run(tmp_path, share=Share.parse("2/3"))
    assert made(tmp_path) == parts[1]
    # Whoever looks sees what all of them are to do.
    (asked,) = WorkFolder(tmp_path, "track").asked()
    assert list(asked["items"]) == NAMES


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "a/b", "-1/3", "1/0", "1/3/5"])
def test_a_share_that_is_none_is_refused(text):
    with pytest.raises(InvalidConfigError, match=r"--shard is .*1/20"):
        Share.parse(text)


def test_damaged_notes_are_no_harm(tmp_path):
    run(tmp_path, NAMES[:1])
    folder = WorkFolder(tmp_path, "track")
    for path in folder.folder.rglob("*.json"):
        path.write_text("{")
    assert folder.asked() == []
    assert folder.record(NAMES[0]) == {}
    (one,) = run(tmp_path, NAMES[:1])
    assert one.kept
    assert folder.record(NAMES[0])["status"] == "done"
