import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import active_children, get_context
from pathlib import Path

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.worker_pool import end_workers, finished_in_workers, require_workers

LONG_S = 120.0


def busy(told: Path, deaf_to: int) -> None:
    """Works on, deaf to so many requests to end, as when the exception of a request is lost."""
    requests = []

    def hear(_signal: int, _frame: object) -> None:
        requests.append(time.monotonic())
        if len(requests) > deaf_to:
            raise SystemExit(1)

    signal.signal(signal.SIGTERM, hear)
    told.touch()
    time.sleep(LONG_S)


@pytest.mark.parametrize("deaf_to", [0, 1, 10**6])
def test_workers_end_although_they_miss_a_request(tmp_path, deaf_to):
    told = tmp_path / "started"
    process = get_context("spawn").Process(target=busy, args=(told, deaf_to))
    process.start()
    while not told.exists():
        assert process.is_alive()
        time.sleep(0.02)
    begin = time.monotonic()
    end_workers(patience_s=3.0)
    assert not process.is_alive()
    assert not active_children()
    assert time.monotonic() - begin < 0.5 * LONG_S


def test_a_pool_can_be_left_after_its_workers_were_ended(tmp_path):
    told = tmp_path / "started"
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        job = pool.submit(busy, told, 1)
        while not told.exists():
            assert not job.done()
            time.sleep(0.02)
        pool.shutdown(wait=False, cancel_futures=True)
        end_workers(patience_s=3.0)
    assert job.exception(timeout=10.0) is not None


@pytest.mark.parametrize("number", [0, -1])
def test_no_workers_are_refused(number):
    with pytest.raises(InvalidConfigError, match=f"workers is {number}"):
        require_workers(number)


@pytest.mark.parametrize("verb", ["simulate", "bench"])
def test_the_command_line_refuses_no_workers(verb, tmp_path, capsys):
    assert cli.main([verb, str(tmp_path / "out"), "--workers", "0"]) == 1
    assert "number of workers is 0" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def touch_and_wait(told: Path) -> Path:
    told.touch()
    if told.name != "first":
        time.sleep(LONG_S)
    return told


def test_closed_results_end_their_workers(tmp_path):
    items = [tmp_path / name for name in ("first", "second", "third", "fourth")]
    begin = time.monotonic()
    results = finished_in_workers(touch_and_wait, items, 2)
    assert next(results) == items[0]
    results.close()
    assert not active_children()
    assert not items[3].exists()
    assert time.monotonic() - begin < 0.5 * LONG_S


def test_the_results_of_workers_come_as_they_are_finished(tmp_path):
    items = [tmp_path / str(number) for number in range(5)]
    assert list(finished_in_workers(Path.touch, items, 2)) == [None] * 5
    assert all(item.exists() for item in items)


def touch_or_die(told: Path) -> Path:
    """A deadly item kills its worker: each time, or the first time only."""
    tries = told.parent / f"{told.name}_tries"
    with tries.open("a") as file:
        file.write("x")
    if told.name == "deadly" or (told.name == "heavy" and tries.stat().st_size == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    told.touch()
    return told


def test_a_worker_that_is_killed_costs_its_own_item_alone(tmp_path):
    items = [tmp_path / name for name in ("first", "deadly", "second", "third")]
    results = finished_in_workers(touch_or_die, items, 2, lost=lambda item: f"lost {item.name}")
    found = list(results)
    assert found.pop() == f"lost {items[1].name}"
    assert sorted(found) == sorted(items[:1] + items[2:])
    assert (tmp_path / "deadly_tries").read_text() == "xx"
    assert not active_children()


def test_an_item_whose_worker_is_killed_once_is_finished_alone(tmp_path):
    # No other item kills: it may be handed out, and not begun, when another worker is killed.
    items = [tmp_path / name for name in ("first", "heavy", "second", "third")]
    assert sorted(finished_in_workers(touch_or_die, items, 2)) == sorted(items)
    assert (tmp_path / "heavy_tries").read_text() == "xx"
    assert not active_children()


def test_without_another_way_lost_items_are_an_error_after_all_others(tmp_path):
    items = [tmp_path / name for name in ("deadly", "first", "second")]
    results = finished_in_workers(touch_or_die, items, 2)
    assert {next(results), next(results)} == set(items[1:])
    with pytest.raises(ClothTrackError, match=r"1 of 3: .*killed, also.*run the same command"):
        next(results)


def die(told: Path) -> None:
    with (told.parent / "tries").open("a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


def test_where_no_worker_finishes_anything_not_every_item_is_tried(tmp_path):
    with pytest.raises(ClothTrackError, match="12 of 12"):
        list(finished_in_workers(die, [tmp_path / str(number) for number in range(12)], 2))
    assert (tmp_path / "tries").stat().st_size <= 6


SLOW = """
import time
from pathlib import Path
from clothtrack.reconstruction.training.batches import loader
class Slow:
    def __len__(self):
        return 2
    def __getitem__(self, draw):
        Path(f"begun_{draw[0]}").touch()
        time.sleep(120.0)
if __name__ == "__main__":
    next(iter(loader(Slow(), [[(0, 0)], [(1, 0)]], list, workers=2)))
"""


def test_no_maker_of_examples_outlives_a_training_that_is_killed(tmp_path):
    (tmp_path / "slow.py").write_text(SLOW)
    with subprocess.Popen(
        [sys.executable, "slow.py"], cwd=tmp_path, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        try:
            while len(list(tmp_path.glob("begun_*"))) < 2:
                assert process.poll() is None, process.communicate()
                time.sleep(0.05)
            process.kill()
            # The pipe ends when the last process that holds it does.
            process.communicate(timeout=15)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
