"""Work that Ray does: the results of worker processes, whoever is killed."""

import hashlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import ClothTrackError
from clothtrack.files.output_lock import LOCK_FILE
from clothtrack.files.worker_pool import finished_in_workers

pytestmark = pytest.mark.slow

LONG_S = 120.0
TINY = (
    "--set", "size_m=[0.2, 0.2]", "--set", "vertex_count=120", "--set", "template.vertex_count=100",
    "--set", "sensor.width=80", "--set", "sensor.height=60", "--set", "sensor.focal=75",
    "--set", "actions=1",
)  # fmt: skip
FAST = ("--set", "search.method=none")


def run(work, items):
    with closing(finished_in_workers(work, items, 2, ray="local", name=repr)) as results:
        return list(results)


@pytest.fixture(scope="module", autouse=True)
def _one_ray():
    """Its start takes seconds: all tests share one."""
    if importlib.util.find_spec("ray") is None:
        pytest.skip("needs Ray: make EXTRAS=ray install")
    run(abs, [0])
    yield
    sys.modules["ray"].shutdown()


def touch_or_die(told: Path) -> str:
    """A deadly item kills its worker each time, a heavy one the first time only."""
    with (told.parent / f"{told.name}_tries").open("a") as file:
        file.write("x")
    tries = (told.parent / f"{told.name}_tries").stat().st_size
    if told.name == "deadly" or (told.name == "heavy" and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return told.name


def test_an_item_whose_worker_is_killed_once_is_tried_again(tmp_path):
    items = [tmp_path / name for name in ("first", "heavy", "second")]
    assert sorted(run(touch_or_die, items)) == ["first", "heavy", "second"]
    assert (tmp_path / "heavy_tries").stat().st_size == 2


def test_an_item_whose_workers_are_killed_is_named(tmp_path):
    with pytest.raises(ClothTrackError, match=r"deadly.*Ray gave it up.*same command again"):
        run(touch_or_die, [tmp_path / "deadly"])


def touch_and_wait(told: Path) -> str:
    if told.name != "first":
        told.touch()
        time.sleep(LONG_S)
        (told.parent / "late").touch()
    return told.name


def test_closed_results_end_their_tasks(tmp_path):
    items = [tmp_path / name for name in ("second", "first", "third", "fourth")]
    begin = time.monotonic()
    with closing(finished_in_workers(touch_and_wait, items, 2, ray="local")) as results:
        assert next(results) == "first"
    assert time.monotonic() - begin < 0.5 * LONG_S
    # Results come as they end.
    assert sorted(run(abs, [-1, -2])) == [1, 2], "the cores are free again"


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1"])
def test_an_address_where_nobody_listens_is_refused_at_once(address, tmp_path):
    # In a process of its own: a Ray that runs here already is used, whatever the address.
    command = [sys.executable, "-m", "clothtrack.cli", "simulate", str(tmp_path / "out")]
    command += ["--benchmark", "all", "--ray", address]
    done = subprocess.run(
        [*command, "--benchmark", "all", "--ray", address],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert f"Ray at '{address}' does not answer" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    out = tmp_path_factory.mktemp("world")
    assert cli.main(["simulate", str(out), "--trajectories", "2", *TINY]) == 0
    return sorted((out / "recordings").iterdir())


def bits(out: Path) -> dict[str, str]:
    """Digests of what was tracked, but the times that it took."""
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in out.glob("*.zarr/**/*")
        if path.is_file() and path.name != "zarr.json" and "steps" not in path.parts
    }


def test_tracking_by_ray_has_the_bits_of_the_pool(recordings, tmp_path, capfd):
    words = ["track", *map(str, recordings), *FAST, "--workers", "2", "--output"]
    assert cli.main([*words, str(tmp_path / "pool")]) == 0
    capfd.readouterr()
    assert cli.main([*words, str(tmp_path / "ray"), "--ray", "local", "--json"]) == 0
    said, complained = capfd.readouterr()
    assert len(json.loads(said)) == 2, "Ray says nothing among the results"
    assert "ray" not in complained.lower()
    assert bits(tmp_path / "pool")
    assert bits(tmp_path / "ray") == bits(tmp_path / "pool")
    assert not list((tmp_path / "ray").rglob(".*"))


def at_work() -> bool:
    """Return whether a worker of Ray works on an item."""
    found = subprocess.run(["pgrep", "-f", "ray::_done_in"], capture_output=True, check=False)
    return found.returncode == 0


def hear_interrupts():
    """What a shell starts in the background ignores Ctrl-C, and so would its children."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize("works", [False, True], ids=["Ray starts", "Ray works"])
@pytest.mark.parametrize(
    "stop",
    [(os.kill, signal.SIGTERM, 143), (os.killpg, signal.SIGINT, -2)],
    ids=["a scheduler", "a terminal"],
)
def test_a_command_that_is_stopped_takes_its_ray_along(
    recordings, tmp_path, stop, works
):  # fmt: skip
    tell, asked, code = stop
    while at_work():
        time.sleep(0.2)  # for the one before
    words = ["track", *map(str, recordings), "--workers", "2", "--ray", "local", "--output"]
    environment = {name: value for name, value in os.environ.items() if "RAY" not in name}
    out = tmp_path / "out"
    with subprocess.Popen(
        [sys.executable, "-m", "clothtrack.cli", *words, str(out)],
        stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment,
        preexec_fn=hear_interrupts,  # noqa: PLW1509
    ) as process:  # fmt: skip
        try:
            while not (out / LOCK_FILE).exists():
                assert process.poll() is None, process.communicate()
                time.sleep(0.05)
            time.sleep(2.0)
            while works and not at_work():
                assert process.poll() is None, process.communicate()
                time.sleep(0.2)
            tell(process.pid, asked)
            # The pipe ends when the last process that holds it does.
            _, complained = process.communicate(timeout=LONG_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == code, complained
    assert "interrupted; what was finished is whole" in complained
    assert not list(out.glob(".*"))
