"""Work that Ray does: the results of worker processes, whoever is killed."""

import hashlib
import importlib.util
import json
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import ClothTrackError, InvalidConfigError, SimulationDivergedError
from clothtrack.files.ray_executor import TRIES, RayExecutor
from clothtrack.files.worker_pool import finished_in_workers

LONG_S = 120.0
TINY = (
    "--set", "size_m=[0.2, 0.2]", "--set", "vertex_count=120", "--set", "template.vertex_count=100",
    "--set", "sensor.width=80", "--set", "sensor.height=60", "--set", "sensor.focal=75",
    "--set", "actions=1",
)  # fmt: skip
FAST = ("--set", "search.method=none")


def run(work, items, processes=2, **options):
    with closing(RayExecutor()(work, items, processes, **options)) as results:
        return list(results)


@pytest.fixture(scope="module", autouse=True)
def _one_ray():
    """Its start takes seconds: all tests share one."""
    if importlib.util.find_spec("ray") is None:
        pytest.skip("needs Ray: make EXTRAS=ray install")
    run(abs, [0])
    yield
    sys.modules["ray"].shutdown()


def square(number: int) -> np.ndarray:
    time.sleep(0.01 * (number % 3))
    return np.full(3, number) ** 2


def test_the_results_are_those_of_worker_processes():
    numbers = list(range(12))
    by_ray = run(square, numbers)
    by_pool = list(finished_in_workers(square, numbers, 2))
    assert sorted(map(str, by_ray)) == sorted(map(str, by_pool))
    by_ray[0] += 1  # Arrays in Ray's own store cannot be written to.
    assert run(square, []) == []


def touch_or_die(told: Path) -> str:
    """A deadly item kills its worker: each time, or the first time only."""
    with (told.parent / f"{told.name}_tries").open("a") as file:
        file.write("x")
    tries = (told.parent / f"{told.name}_tries").stat().st_size
    if told.name.startswith("deadly") or (told.name == "heavy" and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return told.name


def test_a_worker_that_is_killed_costs_its_own_item_alone(tmp_path):
    items = [tmp_path / name for name in ("first", "deadly", "heavy", "second", "third")]
    found = run(touch_or_die, items, lost=lambda item: f"lost {item.name}")
    assert found.pop() == "lost deadly"
    assert sorted(found) == ["first", "heavy", "second", "third"]
    tries = {item.name: (tmp_path / f"{item.name}_tries").stat().st_size for item in items}
    assert tries == {"first": 1, "deadly": TRIES, "heavy": 2, "second": 1, "third": 1}


def test_where_no_worker_finishes_anything_not_every_item_is_tried(tmp_path):
    items = [tmp_path / f"deadly_{number}" for number in range(9)]
    with pytest.raises(ClothTrackError, match=r"9 of 9: .*killed, also.*run the same command"):
        run(touch_or_die, items, 1)
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) == 5


def warn_or_fail(number: int) -> int:
    logging.getLogger("clothtrack.somewhere").warning("number %d is odd", number)
    if number == 3:
        raise SimulationDivergedError("the third diverges")
    return number


def test_errors_and_warnings_come_as_from_here(caplog):
    with pytest.raises(SimulationDivergedError) as failed:
        run(warn_or_fail, [3])
    assert type(failed.value) is SimulationDivergedError
    assert str(failed.value) == "the third diverges"
    assert run(warn_or_fail, [1]) == [1]
    assert "number 1 is odd" in caplog.messages


def touch_and_wait(told: Path) -> str:
    try:
        told.touch()  # The interrupt may come at any moment, also right after this.
        end = time.monotonic() + LONG_S
        while told.name != "first" and time.monotonic() < end:
            time.sleep(0.05)
    finally:
        told.unlink(missing_ok=True)
    return told.name


def test_closed_results_end_their_tasks_which_clear_away(tmp_path):
    items = [tmp_path / name for name in ("second", "first", "third", "fourth")]
    begin = time.monotonic()
    results = RayExecutor()(touch_and_wait, items, 2)
    assert next(results) == "first"
    results.close()
    assert list(tmp_path.iterdir()) == []
    assert time.monotonic() - begin < 0.5 * LONG_S


def test_tasks_end_too_where_a_shell_has_started_everything_in_the_background():
    """Such processes ignore SIGINT, and so do their workers, which Ray ends by it."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN);"
        "from pathlib import Path; from clothtrack.files.ray_executor import RayExecutor;"
        "from tests.files.test_ray_executor import touch_and_wait as work;"
        "items = [Path(sys.argv[1]) / name for name in ('second', 'first', 'third')];"
        "results = RayExecutor()(work, items, 2);"
        "print(next(results)); results.close()"
    )
    here = Path(__file__).parents[2]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-c", code, folder],
            cwd=here, env={**os.environ, "PYTHONPATH": str(here)}, check=False,
            capture_output=True, text=True,
        )  # fmt: skip
        assert (done.returncode, done.stdout) == (0, "first\n"), done.stderr
        assert list(Path(folder).iterdir()) == []


def test_what_no_machine_has_is_refused():
    with pytest.raises(InvalidConfigError, match=r"1e\+06 GB of memory.*ask for less"):
        next(RayExecutor(memory_gb=1e6)(abs, [1], 2))
    with pytest.raises(InvalidConfigError, match="50 graphics cards"):
        next(RayExecutor(gpus=50.0)(abs, [1], 2))
    with pytest.raises(InvalidConfigError, match="memory_gb is -1"):
        RayExecutor(memory_gb=-1.0)
    assert list(RayExecutor(memory_gb=0.1)(abs, [-1], 2)) == [1]


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "[::1]:99999"])
def test_an_address_where_nobody_listens_is_refused_at_once(address, tmp_path):
    # In a process of its own: a Ray that runs here already is used, whatever the address.
    command = [sys.executable, "-m", "clothtrack.cli", "bench", str(tmp_path / "out")]
    done = subprocess.run(
        [*command, "--ray", address], check=False, capture_output=True, text=True, timeout=60
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


def no_litter(out: Path) -> None:
    assert not [path for path in out.rglob(".*") if path.name != ".work"]
    assert not list(out.glob(".work/*/claims/*"))


def kill_a_claimant(claims: Path) -> None:
    """Kill the first process that claims something."""
    end = time.monotonic() + LONG_S
    while time.monotonic() < end:
        for path in claims.glob("[!.]*"):
            with suppress(OSError, ValueError):
                owner = json.loads(path.read_text())
                assert owner["pid"] != os.getpid()
                os.kill(owner["pid"], signal.SIGKILL)
                return
        time.sleep(0.01)


def test_tracking_by_ray_has_the_bits_of_the_pool_although_a_worker_is_killed(
    recordings, tmp_path, capfd
):  # fmt: skip
    words = ["track", *map(str, recordings), *FAST, "--workers", "2", "--output"]
    assert cli.main([*words, str(tmp_path / "pool")]) == 0
    claims = tmp_path / "killed" / ".work" / "track" / "claims"
    killer = threading.Thread(target=kill_a_claimant, args=(claims,))
    killer.start()
    capfd.readouterr()
    assert cli.main([*words, str(tmp_path / "killed"), "--ray", "local", "--json"]) == 0
    killer.join()
    said, complained = capfd.readouterr()
    assert len(json.loads(said)) == 2, "Ray says nothing among the results"
    assert "ray" not in complained.lower()
    assert bits(tmp_path / "pool")
    assert bits(tmp_path / "killed") == bits(tmp_path / "pool")
    no_litter(tmp_path / "killed")


@pytest.mark.slow
@pytest.mark.parametrize("tell", [os.kill, os.killpg], ids=["it", "all"])
@pytest.mark.parametrize(("asked", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, -2)])
def test_a_command_that_is_stopped_takes_its_ray_along(
    recordings, tmp_path, tell, asked, code
):  # fmt: skip
    words = ["track", *map(str, recordings), "--workers", "2", "--ray", "local", "--output"]
    environment = {name: value for name, value in os.environ.items() if "RAY" not in name}
    with subprocess.Popen(
        [sys.executable, "-m", "clothtrack.cli", *words, str(tmp_path / "out")],
        stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment,
    ) as process:  # fmt: skip
        try:
            claims = tmp_path / "out" / ".work" / "track" / "claims"
            while not list(claims.glob("[!.]*")):
                assert process.poll() is None, process.communicate()
                time.sleep(0.05)
            tell(process.pid, asked)
            # The pipe ends when the last process that holds it does.
            _, complained = process.communicate(timeout=LONG_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == code, complained
    assert "interrupted; what was finished is whole" in complained
    no_litter(tmp_path / "out")


def test_wrong_ways_to_ask_are_refused(recordings, tmp_path, capsys):
    words = ["track", str(recordings[0]), "--output", str(tmp_path)]
    assert cli.main([*words, "--ray-memory", "2"]) == 1
    assert "--ray-memory is 2, without --ray" in capsys.readouterr().err
    assert cli.main([*words, "--ray", "local", "--live"]) == 1
    assert "leave out --ray" in capsys.readouterr().err
    assert cli.main(["flatten", str(tmp_path), "--ray", "local", "--live"]) == 2
    assert "or --live" in capsys.readouterr().err


def test_without_the_extra_one_line_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InvalidConfigError, match="needs ray; install with: "):
        next(RayExecutor()(abs, [1], 2))
