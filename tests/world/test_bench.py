"""The benchmark: its list, its ranges, and that what lies on disk is what the list says."""

import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import astuple, fields, replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, SimulationDivergedError
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.store import read_recording
from clothtrack_lab.world import bench_generation
from clothtrack_lab.world.bench import BenchTrajectory, Ranges, hardened, trajectories, vary
from clothtrack_lab.world.bench_generation import generate_bench
from clothtrack_lab.world.episodes import EpisodeConfig, TemplateConfig

SMALL = SensorConfig(width=80, height=60, focal=75.0)
TINY = {
    "size_m": (0.2, 0.2),
    "vertex_count": 120,
    "actions": 1,
    "template": TemplateConfig(vertex_count=100),
    "sensor": SMALL,
}
PAIR = [
    BenchTrajectory(f"towel_dev_{number:02d}", "towel", "dev", 1000 + 6 * number, changes=TINY)
    for number in range(2)
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench")
    generate_bench(out, PAIR)
    return out


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def document(out: Path) -> dict:
    return json.loads((out / "bench.json").read_text())


def film_tiny(hardness: str, out: Path, **changes: object) -> np.lib.npyio.NpzFile:
    """The truth file of a tiny trajectory that is hard in one way."""
    one = BenchTrajectory("one", "towel", "hard", 3000, hardness, {**TINY, **changes})
    generate_bench(out, [one])
    return np.load(out / "truth" / "one.npz")


def test_fifty_trajectories_and_ten_hard_ones() -> None:
    normal = trajectories(("dev", "test"))
    assert len(normal) == 50
    assert sum(one.kind == "towel" for one in normal) == 25
    assert {one.hardness for one in normal} == {"none"}
    hard = trajectories(("hard",))
    assert len(hard) == 10
    assert len({(one.kind, one.hardness) for one in hard}) == 10


def test_the_printed_variant_is_the_same_but_for_its_print() -> None:
    for plain, printed in zip(trajectories(), trajectories(printed=True), strict=True):
        assert replace(printed, changes={}) == plain
        config = printed.config(printed.seed)
        assert config.printed
        assert replace(config, printed=False) == plain.config(plain.seed)


def test_a_list_from_before_a_setting_existed_is_gone_on_with(copy: Path) -> None:
    whole = document(copy)
    for entry in whole["trajectories"]:
        del entry["varied"]["printed"]
    (copy / "bench.json").write_text(json.dumps(whole))
    filmed = []
    generate_bench(copy, PAIR, progress=lambda *told: filmed.append(told))
    assert document(copy) == whole  # nothing was filmed again
    printed = [replace(one, changes={**TINY, "printed": True}) for one in PAIR]
    with pytest.raises(InvalidConfigError, match="printed"):
        generate_bench(copy, printed)


def test_no_seed_is_used_twice_even_by_a_replacement() -> None:
    for kind in ("towel", "tshirt"):
        seeds = [seed for one in trajectories() if one.kind == kind for seed in one.seeds]
        assert len(seeds) == len(set(seeds))
    names = [one.name for one in trajectories()]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_every_value_is_drawn_from_its_range(kind: str) -> None:
    ranges = Ranges()
    drawn = [vary(kind, seed) for seed in range(200)]
    for name in ("young_pa", "contact_radius_m", "table_friction", "cloth_friction"):
        values = [getattr(one.fabric, name) for one in drawn]
        low, high = getattr(ranges, name)
        assert low <= min(values) < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < max(values) <= high
    for name in ("white_m", "tilt_deg", "focal", "patch_dropout"):
        values = [getattr(one.sensor, name) for one in drawn]
        low, high = getattr(ranges, name)
        assert low <= min(values) < max(values) <= high
    assert len({one.size_m for one in drawn}) == 200
    assert len({one.tool.radii_m for one in drawn}) == 200


def test_the_seed_alone_decides() -> None:
    assert vary("towel", 7) == vary("towel", 7)
    assert vary("towel", 7) != vary("towel", 8)
    assert astuple(vary("towel", 7).fabric) != astuple(vary("tshirt", 7).fabric)


def test_every_range_is_one() -> None:
    for one in fields(Ranges):
        low, high = getattr(Ranges(), one.name)
        assert low < high, one.name


def test_hardness_changes_only_what_it_names() -> None:
    plain = vary("tshirt", 3000)
    assert hardened(plain, "none") == plain
    assert replace(hardened(plain, "calibration"), calibration_error_m=0.0) == plain
    assert replace(hardened(plain, "missing"), sensor=plain.sensor) == plain
    assert replace(hardened(plain, "middle"), action=plain.action) == plain
    assert replace(hardened(plain, "folded"), action=plain.action) == plain
    hidden = hardened(plain, "hidden")
    assert replace(hidden, tool=plain.tool, reach_across=False) == plain


def test_the_list_tells_all_that_varied(made: Path) -> None:
    first, second = document(made)["trajectories"]
    assert [first["name"], second["name"]] == ["towel_dev_00", "towel_dev_01"]
    assert first["varied"]["fabric"] != second["varied"]["fabric"]
    assert first["seed"] == 1000
    truth = np.load(made / "truth" / "towel_dev_00.npz")
    assert json.loads(str(truth["fabric"])) == first["varied"]["fabric"]
    assert first["measured"]["frames"] == len(truth["frames"])
    for name in ("hidden_by_tool", "depth_missing", "outside_picture", "gripper_closed"):
        assert len(truth[name]) == len(truth["frames"])


@pytest.mark.slow
def test_equal_seeds_give_equal_bytes_in_another_process(made: Path, tmp_path: Path) -> None:
    generate_bench(tmp_path, PAIR, processes=2)
    for ours, theirs in zip(
        document(made)["trajectories"], document(tmp_path)["trajectories"], strict=True
    ):
        assert {**ours, "cpu_s": 0} == {**theirs, "cpu_s": 0}
    for path in (*made.rglob("*.png"), *made.rglob("recording.json")):
        assert path.read_bytes() == (tmp_path / path.relative_to(made)).read_bytes()


def test_what_is_finished_is_kept(copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in copy.glob("[!.]*/**/*")}
    seen = []
    generate_bench(copy, PAIR, progress=lambda *told: seen.append(told))
    assert [done for _, *done in seen] == [[0, 2], [1, 2], [2, 2]]
    assert {path: path.stat().st_mtime_ns for path in copy.glob("[!.]*/**/*")} == before


def test_what_is_missing_is_made_again(copy: Path) -> None:
    whole = document(copy)
    (copy / "truth" / "towel_dev_01.npz").unlink()
    generate_bench(copy, PAIR)
    assert (copy / "truth" / "towel_dev_01.npz").exists()
    again = document(copy)["trajectories"][1]
    assert {**again, "cpu_s": 0} == {**whole["trajectories"][1], "cpu_s": 0}


def test_another_recipe_is_not_mixed_in(copy: Path) -> None:
    other = replace(PAIR[0], changes={**TINY, "actions": 2})
    with pytest.raises(InvalidConfigError, match="other settings"):
        generate_bench(copy, [other])


def test_a_diverged_trajectory_gets_the_next_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film, tried = bench_generation.simulate_trajectory, []

    def diverge_once(kind: str, seed: int, *rest: object, **options: object) -> Path:
        tried.append(seed)
        if seed == 1000:
            raise SimulationDivergedError("on purpose")
        return film(kind, seed, *rest, **options)

    monkeypatch.setattr(bench_generation, "simulate_trajectory", diverge_once)
    (entry,) = generate_bench(tmp_path, PAIR[:1])
    assert tried == [1000, 1001]
    assert (entry["name"], entry["seed"]) == ("towel_dev_00", 1001)
    assert entry["varied"]["fabric"] == json.loads(json.dumps(entry["varied"]["fabric"]))
    assert generate_bench(tmp_path, PAIR[:1]) == [entry]
    assert tried == [1000, 1001]


def test_a_trajectory_that_always_diverges_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverge(*_: object, **__: object) -> Path:
        raise SimulationDivergedError("on purpose")

    monkeypatch.setattr(bench_generation, "simulate_trajectory", diverge)
    with pytest.raises(SimulationDivergedError, match="towel_dev_00"):
        generate_bench(tmp_path, PAIR[:1])


@pytest.mark.slow
def test_an_interrupt_leaves_nothing_half_written(tmp_path: Path) -> None:
    out = tmp_path / "bench"
    file = tmp_path / "script.py"
    # What starts in a shell's background ignores the signal, and hands that on.
    file.write_text(
        "import signal\n"
        "from clothtrack.cli.command_line import main\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"    words = ['simulate', {str(out)!r}, '--benchmark', 'all', '--workers', '2']\n"
        "    raise SystemExit(main(words))\n"
    )
    with subprocess.Popen([sys.executable, str(file)], stderr=subprocess.PIPE, text=True) as run:
        try:
            limit = time.monotonic() + 60.0
            while len(list(out.glob("recordings/.*"))) < 2 and time.monotonic() < limit:
                time.sleep(0.05)
            run.send_signal(signal.SIGINT)
            _, told = run.communicate(timeout=60)
        finally:
            run.terminate()
    assert run.returncode == 130
    assert "interrupted" in told
    assert "Traceback" not in told
    assert list((out / "recordings").iterdir()) == []


@pytest.mark.slow
def test_picks_of_folded_cloth_are_told(tmp_path: Path) -> None:
    truth = film_tiny("folded", tmp_path, actions=2)
    assert truth["picked_folded"].tolist() == [False, True]


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny trajectory that the hard ones are held against."""
    out = tmp_path_factory.mktemp("usual")
    film_tiny("none", out)
    return out


def test_an_arm_hides_much_more_than_a_rod(usual: Path, tmp_path: Path) -> None:
    hidden, plain = film_tiny("hidden", tmp_path), np.load(usual / "truth" / "one.npz")
    (arm, rod), (with_arm, with_rod) = (
        [truth[name][truth["gripper_closed"]] for truth in (hidden, plain)]
        for name in ("hidden_by_tool", "positions")
    )
    assert arm.mean() > 0.3
    assert rod.mean() < 0.2
    assert np.array_equal(with_arm, with_rod)
    assert hidden["hidden_by_tool"][-1] == 0.0


def test_a_calibration_error_is_in_the_recording_alone(usual: Path, tmp_path: Path) -> None:
    film_tiny("calibration", tmp_path)
    wrong, right = (read_recording(out / "recordings" / "one") for out in (tmp_path, usual))
    offset = wrong.cameras[0].position - right.cameras[0].position
    assert np.linalg.norm(offset) == pytest.approx(0.005)
    for mine, theirs in zip(wrong.frames, right.frames, strict=True):
        assert mine.depth["top"].read_bytes() == theirs.depth["top"].read_bytes()


def test_missing_depth_has_the_promised_share(tmp_path: Path) -> None:
    exact = SensorConfig.perfect(
        width=160, height=120, focal=150.0, step_m=0.0005, patch_pixels=8.0
    )
    sensor = hardened(EpisodeConfig(sensor=exact), "missing").sensor
    truth = film_tiny("none", tmp_path, sensor=sensor)
    assert truth["depth_missing"].mean() == pytest.approx(0.2, abs=0.05)
