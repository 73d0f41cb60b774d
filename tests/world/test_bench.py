"""The benchmark: its list, its ranges, and that what lies on disk is what the list says."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, SimulationDivergedError
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.store import read_recording
from clothtrack_lab.world import bench_generation
from clothtrack_lab.world.bench import BenchTrajectory, trajectories
from clothtrack_lab.world.bench_generation import generate_bench
from clothtrack_lab.world.episodes import TemplateConfig

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


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny trajectory that the hard ones are held against."""
    out = tmp_path_factory.mktemp("usual")
    film_tiny("none", out)
    return out


def test_a_calibration_error_is_in_the_recording_alone(usual: Path, tmp_path: Path) -> None:
    film_tiny("calibration", tmp_path)
    wrong, right = (read_recording(out / "recordings" / "one") for out in (tmp_path, usual))
    offset = wrong.cameras[0].position - right.cameras[0].position
    assert np.linalg.norm(offset) == pytest.approx(0.005)
    for mine, theirs in zip(wrong.frames, right.frames, strict=True):
        assert mine.depth["top"].read_bytes() == theirs.depth["top"].read_bytes()
