import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from multiprocessing import active_children
from pathlib import Path

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.worker_pool import finished_in_workers

LONG_S = 120.0


@pytest.mark.parametrize("more", [[], ["--benchmark", "all"]])
def test_the_command_line_refuses_no_workers(more, tmp_path, capsys):
    assert cli.main(["simulate", str(tmp_path / "out"), *more, "--workers", "0"]) == 1
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


def touch_or_die(told: Path) -> Path:
    """A deadly item kills its worker when the first one is finished."""
    told.touch()
    if told.name == "deadly":
        while not (told.parent / "first").exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGKILL)
    if told.name == "slow":
        time.sleep(LONG_S)
    return told


def test_a_worker_that_dies_ends_the_others_and_what_was_under_way_is_named(tmp_path):
    items = [tmp_path / name for name in ("first", "deadly", "slow", "fourth")]
    begin = time.monotonic()
    results = finished_in_workers(touch_or_die, items, 2, name=lambda item: item.name)
    with pytest.raises(ClothTrackError, match=r"died .*under way: deadly.*same command again"):
        list(results)
    assert not active_children()
    assert time.monotonic() - begin < 0.5 * LONG_S


def test_without_ray_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InvalidConfigError, match="needs ray; install with: "):
        list(finished_in_workers(abs, [1], 2, ray="local"))


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


@pytest.mark.slow
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
