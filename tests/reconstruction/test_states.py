"""Crumpled states: sound cloth, the same from the same seed, whole after whatever interrupts."""

import shutil
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, SimulationDivergedError
from clothtrack.files.atomic_write import hidden_name
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossings, edge_strain
from clothtrack.reconstruction.data import states
from clothtrack.reconstruction.data.crumpling import CrumpledState, Crumpler
from clothtrack.reconstruction.data.recipes import CrumplingConfig
from clothtrack.reconstruction.data.state_store import open_states, read_shard, shard_path
from clothtrack.reconstruction.data.states import (
    StatesConfig,
    generate_states,
    make_shard,
)
from clothtrack.simulation.parameters import ClothParameters, SolverConfig

SOFT = ClothParameters(stretch_compliance=2e-3, bend_compliance=30.0)

CRUMPLING = CrumplingConfig(states=2, rest_limit_s=0.3)
TINY = StatesConfig(vertex_count=120, episodes=2, crumpling=CRUMPLING)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("states")
    generate_states(out, "towel", 5, seed=3, config=TINY)
    return out


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def bytes_of(folder: Path) -> dict[str, bytes]:
    files = [one for one in (folder / "shards").rglob("*") if one.is_file()]
    return {str(one.relative_to(folder)): one.read_bytes() for one in files}


def leftovers(folder: Path) -> list[Path]:
    """What is half-written, and the lock."""
    return [*folder.glob("shards/.*"), *folder.glob(".*")]


def left_by_a_dead_process(folder: Path, name: str) -> None:
    (folder / hidden_name(name)).mkdir()


def test_there_are_at_least_as_many_as_asked_in_whole_shards(made: Path) -> None:
    found = open_states(made)
    shards = [read_shard(path) for path in found.shards]
    assert [len(shard.positions) for shard in shards] == [4, 4]
    assert found.document["config"]["vertex_count"] == 120
    longest = TINY.garments.towel_side_m
    least = TINY.garments.towel_aspect[0]
    for shard in shards:
        size = np.ptp(shard.mesh.vertices, axis=0)
        assert longest[0] <= size[:2].max() <= longest[1] + 1e-9
        assert size[:2].min() >= least * size[:2].max() - 1e-9
        assert len(np.unique(shard.episodes)) >= 2
    assert not np.array_equal(shards[0].mesh.vertices[-1], shards[1].mesh.vertices[-1])


def test_states_are_sound_cloth_on_the_table_near_the_origin(made: Path) -> None:
    shard = read_shard(shard_path(made, 0))
    flat = np.ptp(shard.mesh.vertices[:, :2], axis=0).prod()
    for number, vertices in enumerate(shard.positions):
        measured = {name: values[number] for name, values in shard.measures.items()}
        assert vertices[:, 2].min() > 0.0002
        assert vertices[:, 2].min() < 0.01 or shard.recipes[number] == "held"
        middle = 0.5 * (vertices[:, :2].min(axis=0) + vertices[:, :2].max(axis=0))
        assert np.abs(middle).max() <= TINY.shift_m + 1e-6
        assert measured["strain"] == pytest.approx(edge_strain(shard.mesh, vertices), rel=1e-3)
        assert measured["strain"] < 0.07
        assert measured["crossings"] == crossings(vertices, shard.mesh.faces)
        assert 0.0 < measured["coverage"] < 1.02
        assert np.ptp(vertices[:, :2], axis=0).prod() >= 0.98 * measured["coverage"] * flat


def test_a_shard_depends_on_its_seed_and_number_alone(made: Path) -> None:
    alone = make_shard("towel", 1, 3, TINY)
    assert np.array_equal(alone.positions, read_shard(shard_path(made, 1)).positions)
    assert not np.array_equal(make_shard("towel", 1, 4, TINY).positions, alone.positions)


def test_a_finished_shard_is_kept_and_a_broken_one_made_again(copy: Path) -> None:
    whole = bytes_of(copy)
    times = {path: path.stat().st_mtime_ns for path in (copy / "shards/0000.zarr").rglob("*")}
    chunk = max((copy / "shards/0001.zarr/positions/c").rglob("*"), key=lambda one: one.is_file())
    chunk.write_bytes(chunk.read_bytes()[:100])
    left_by_a_dead_process(copy / "shards", "0001.zarr")
    told = []
    generate_states(
        copy, "towel", 8, seed=3, config=TINY, progress=lambda *words: told.append(words[1:])
    )
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert {path: path.stat().st_mtime_ns for path in times} == times
    assert bytes_of(copy) == whole
    assert not leftovers(copy)


def test_states_of_another_kind_are_not_mixed_in(copy: Path) -> None:
    before = bytes_of(copy)
    wrong = {"kind": "tshirt", "seed": 4, "config": replace(TINY, vertex_count=130)}
    for name, value in wrong.items():
        asked = {"kind": "towel", "seed": 3, "config": TINY, name: value}
        with pytest.raises(InvalidConfigError, match=f"another {name}"):
            generate_states(copy, states=8, **asked)
    (copy / "states.json").unlink()
    with pytest.raises(InvalidConfigError, match=r"states\.json"):
        generate_states(copy, "towel", 8, seed=3, config=TINY)
    assert bytes_of(copy) == before


def test_what_is_not_sound_is_left_out_until_nothing_is_left(tmp_path: Path) -> None:
    strict = replace(CRUMPLING, strain_limit=0.0, folded_strain_limit=0.0)
    exploding = replace(TINY, crumpling=strict)
    crossing = replace(TINY, crossings_limit=-1.0, folded_crossings_limit=-1.0)
    for config in (exploding, crossing):
        with pytest.raises(SimulationDivergedError, match="only 0 of 4"):
            generate_states(tmp_path / "none", "towel", 1, config=config)
        shutil.rmtree(tmp_path / "none")


def test_a_garment_that_comes_to_nothing_is_exchanged_for_another(monkeypatch, caplog) -> None:
    """One in fifty of a long run must not end it, and its place must not stay empty."""
    first = make_shard("towel", 1, 3, TINY).mesh

    def only_the_first_crosses(positions, faces):
        return len(faces) if np.array_equal(faces, first.faces) else 0

    monkeypatch.setattr(states, "crossings", only_the_first_crosses)
    shard = make_shard("towel", 1, 3, TINY)
    assert len(shard.positions) == TINY.shard_states
    assert not np.array_equal(shard.mesh.faces, first.faces)
    assert "only 0 of 4 states" in caplog.text
    assert "another garment is drawn" in caplog.text


def test_a_fold_halves_a_towel_and_keeps_its_layers_in_order() -> None:
    for seed in range(2):
        mesh, (state,) = episode("fold", seed, pressed=0.0)
        folded = state.positions
        covered = projected_area(folded, mesh.faces) / projected_area(mesh.vertices, mesh.faces)
        assert 0.45 < covered < 0.93
        assert np.median(folded[:, 2]) < 0.015
        assert crossings(folded, mesh.faces) <= 0.01 * len(mesh.edges)
        assert edge_strain(mesh, folded) < 0.01


def test_held_cloth_hangs_in_the_air_and_falls_when_it_is_let_go() -> None:
    heights = []
    for seed in range(2):
        _, (held, released) = episode("held", seed, states=2)
        assert (held.recipe, released.recipe) == ("held", "release")
        top = int(held.positions[:, 2].argmax())
        heights.append(held.positions[top, 2])
        assert released.positions[top, 2] < 0.6 * held.positions[top, 2] + 0.03
    assert max(heights) > 0.2


@pytest.mark.slow
def test_an_interrupt_between_two_shards_ends_the_workers(tmp_path: Path) -> None:
    """It may come while a finished shard is listed; a traceback must not keep workers going."""

    def interrupt(place: str, done: int, total: int) -> None:
        if not done:
            return
        left_by_a_dead_process(tmp_path / "shards", "0003.zarr")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate_states(tmp_path, "towel", 400, config=TINY, processes=2, progress=interrupt)
    assert not active_children()
    assert not leftovers(tmp_path)
    assert 1 <= len(open_states(tmp_path).shards) < 20


@pytest.mark.parametrize("kind", ["tshirt", "trousers"])
def test_the_verb_makes_states(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["simulate", str(tmp_path), "--garment", kind, "--states", "3", "--seed", "5"]
    sizes = ["vertex_count=150", "episodes=2", "crumpling.states=2", "crumpling.rest_limit_s=0.2"]
    assert cli.main([*words, *(word for one in sizes for word in ("--set", one))]) == 0
    card, told = capsys.readouterr().out.split(maxsplit=1)
    assert Path(card) == tmp_path / "README.md"
    assert "1 garments" in told
    found = open_states(tmp_path)
    assert (found.kind, found.document["seed"]) == (kind, 5)
    (shard,) = (read_shard(path) for path in found.shards)
    assert shard.positions.shape == (4, shard.mesh.vertex_count, 3)
    assert 100 < shard.mesh.vertex_count < 200


@pytest.mark.parametrize(
    ("words", "told", "status"),
    [
        (["--garment", "trousers"], "--states", 2),
        (["--states", "5", "--trajectories", "1"], "--states records nothing; leave", 2),
        (["--states", "5", "--actions", "3"], "--states records nothing; leave", 2),
        (["--states", "5", "--garment", "sock"], "sock", 2),
        (["--states", "0"], "states", 1),
        (["--states", "5", "--set", "episodes=0"], "episodes", 1),
        (["--states", "5", "--workers", "0"], "workers", 1),
    ],
)
def test_wrong_words_on_the_command_line(
    words: list[str], told: str, status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["simulate", str(tmp_path / "out"), *words]) == status
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def episode(recipe: str, seed: int = 0, **changes: object) -> tuple[ClothMesh, list[CrumpledState]]:
    """Return the states of an episode that begins with a recipe, and the towel."""
    crumpling = CrumplingConfig(
        **{"states": 1, "shares": {recipe: 1.0}, "next_shares": {"pick_and_place": 1.0}, **changes}
    )
    mesh = garment("towel", vertex_count=300, pattern="random")
    crumpler = Crumpler(mesh, crumpling, SolverConfig(edge_contact=False, damping=4.0))
    return mesh, list(crumpler.episode(SOFT, np.random.default_rng(seed)))
