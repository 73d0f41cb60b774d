"""The same work on many items: kept, tried, failed, and killed in the middle."""

import os
import signal
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest

from clothtrack.errors import ClothTrackError, SimulationDivergedError, StorageError
from clothtrack.files.atomic_write import atomic_file, write_file
from clothtrack.files.many_items import attempts, results_of

NAMES = [f"item_{number}" for number in range(8)]


@dataclass(frozen=True)
class Writing:
    """Writes a file for each name, and notes in `made` that it has."""

    out: Path

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
        if item.startswith("bad"):
            raise SimulationDivergedError(f"{item} diverges")
        if item.startswith("full"):
            raise StorageError("the disk is full")
        if item.startswith("deadly"):
            with atomic_file(self.paths(item)[0]):
                os.kill(os.getpid(), signal.SIGKILL)
        write_file(self.paths(item)[0], item.upper().encode())
        return item.upper()


def run(out: Path, names=NAMES, **options):
    with closing(attempts(Writing(out), names, kind="items", **options)) as tries:
        return list(tries)


def made(out: Path) -> list[str]:
    return sorted((out / "made").read_text().split())


@pytest.mark.parametrize("workers", [1, 3])
def test_what_is_finished_is_kept_and_what_failed_is_tried_again(tmp_path, workers):
    seen = []
    names = ["bad", *NAMES[:2]]
    tries = run(tmp_path, names, progress=lambda *told: seen.append(told), workers=workers)
    assert {one.item: str(one.error) for one in tries} == {
        "bad": "bad diverges", NAMES[0]: "None", NAMES[1]: "None",
    }  # fmt: skip
    assert [done for _, done, _ in seen] == [0, 1, 2, 3]
    assert seen[0][0] == "0/3 items"
    again = run(tmp_path, names, workers=workers)
    assert {one.item: one.result for one in again} == {
        "bad": None, NAMES[0]: "ITEM_0", NAMES[1]: "ITEM_1",
    }  # fmt: skip
    assert made(tmp_path) == sorted(["bad", "bad", *NAMES[:2]])


def test_a_killed_worker_leaves_nothing_half_written_and_the_next_run_goes_on(tmp_path):
    with pytest.raises(ClothTrackError, match=r"under way: .*deadly"):
        run(tmp_path, [*NAMES, "deadly"], workers=2)
    assert not list(tmp_path.glob(".*"))
    finished = {path.stem for path in tmp_path.glob("*.txt")}
    assert len(finished) >= len(NAMES) - 1
    tries = run(tmp_path, NAMES)
    assert [one.result for one in tries] == [name.upper() for name in NAMES]
    again = [name for name in NAMES if made(tmp_path).count(name) > 1]
    assert not finished & set(again)


def test_an_error_is_raised_after_all_others_and_one_of_the_disk_at_once(tmp_path):
    results = results_of(iter(run(tmp_path, ["bad", *NAMES])))
    assert [next(results) for _ in NAMES] == [(name, name.upper()) for name in NAMES]
    with pytest.raises(ClothTrackError, match="bad diverges"):
        next(results)
    with pytest.raises(StorageError), closing(
        attempts(Writing(tmp_path), ["full", "last"], kind="items")
    ) as tries:  # fmt: skip
        list(results_of(tries))
    assert "last" not in made(tmp_path)
