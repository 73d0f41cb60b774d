"""Training on packed states: the garments held out, runs in pieces, and files in pieces."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
import torch

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.state_store import (
    StateShard,
    open_states,
    read_shard,
    shard_digest,
    write_states,
)
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.packed_states import PackedStates, read_pack, write_pack
from clothtrack.reconstruction.tokens.packed_training import pretrain_packed
from clothtrack.reconstruction.tokens.token_examples import TokenExamples
from clothtrack.reconstruction.tokens.token_learning import split_by_digest
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack.reconstruction.training.pieces import MANIFEST, join_pieces, write_pieces
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import read_scalars

TINY = TokenNetworkConfig(width=16, layers=1)
FILES = ("progress.pt", "best.safetensors", "model.safetensors", "scalars.jsonl")
CONFIG = TrainingConfig(
    batch_size=4, low_rate=1e-6, high_rate=2e-3, decay="stable", rise_examples=8, fall_examples=24,
    average_examples=16, evaluate_examples=12, held_out_share=0.01, log_steps=1, save_steps=1,
    gradient_limit=1.0,
)  # fmt: skip


def folder_of(path: Path, seed: int = 0) -> Path:
    """States of three flat towels, each lifted into waves of its own."""
    shards = []
    for number in range(3):
        mesh = garment("towel", vertex_count=200, size_m=(0.3 + 0.1 * number, 0.25))
        rng = np.random.default_rng([seed, number])
        positions = np.repeat(np.asarray(mesh.vertices, np.float32)[None], 6, axis=0)
        waves = rng.uniform(5.0, 20.0, (6, 1))
        positions[..., 2] = 0.005 + 0.01 * (1.0 + np.sin(waves * positions[..., 0]))
        shards.append(StateShard("towel", mesh, positions, np.arange(6), ("drop",) * 6, number))
    write_states(path, "towel", shards, {})
    return path


def pack_of(folder: Path, file: Path) -> Path:
    packs = []
    for path in open_states(folder).shards:
        shard, digest = read_shard(path), shard_digest(path)
        tokens = GarmentTokens.of(shard.mesh)
        packs.append(PackedStates.of(shard.mesh.faces, tokens, shard.positions, digest))
    write_pack(file, PackedStates.joined(packs), {"seed": 0})
    return file


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("packed")
    return pack_of(folder_of(out / "states"), out / "pack.safetensors")


class StopAfter:
    """Asks the training to stop, as a scheduler does."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def __call__(self, name: str, done: int, total: int) -> None:
        del name, total
        if done == self.steps:
            os.kill(os.getpid(), signal.SIGTERM)


def test_the_garments_held_out_are_those_of_any_training(tmp_path: Path, pack: Path) -> None:
    states, _ = read_pack(pack)
    folder = folder_of(tmp_path / "states")
    examples = TokenExamples([open_states(folder)], TINY)
    second = sorted({int(one, 16) / 16**8 for one in states.groups})[1]
    for share, count in ((0.0, 1), (second + 1e-6, 2)):
        expected = split_by_digest(examples.groups, share)
        assert len(expected[1]) == 6 * count
        for found, wanted in zip(split_by_digest(states.groups, share), expected, strict=True):
            np.testing.assert_array_equal(found, wanted)


@pytest.mark.slow
def test_a_run_that_is_carried_away_in_pieces_goes_on_as_if_it_had_not(
    tmp_path: Path, pack: Path
) -> None:
    whole = pretrain_packed([pack], TINY, CONFIG, tmp_path / "whole")
    here, pieces, there = (tmp_path / one for one in ("here", "pieces", "there"))
    pretrain_packed([pack], TINY, CONFIG, here, progress=StopAfter(3))
    write_pieces(here, FILES, pieces, most_bytes=50_000)
    join_pieces(pieces, there)
    learned = pretrain_packed([pack], TINY, CONFIG, there)
    assert learned.stages["tokens"].status == "finished"
    assert learned.stages["tokens"].steps == 6
    assert read_scalars(there) == read_scalars(tmp_path / "whole")
    assert whole.model is not None
    assert learned.model is not None
    first, second = (load_weights(one.model).tensors for one in (whole, learned))
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
    # What a run leaves works as any weights do.
    assert TokenReconstructor.load(learned.model).model.config == TINY


@pytest.mark.slow
def test_a_run_goes_on_with_other_packs(tmp_path: Path, pack: Path) -> None:
    other = pack_of(folder_of(tmp_path / "states", seed=1), tmp_path / "other.safetensors")
    pretrain_packed([pack], TINY, CONFIG, tmp_path / "run", progress=StopAfter(3))
    learned = pretrain_packed([pack, other], TINY, CONFIG, tmp_path / "run")
    assert learned.model is not None
    phases = load_weights(learned.model).provenance["phases"]
    assert [one["from_step"] for one in phases] == [0, 3]
    assert [one["data"]["states"] for one in phases] == [18, 36]


def test_several_processes_are_refused(tmp_path: Path, pack: Path) -> None:
    with pytest.raises(InvalidConfigError, match="2 processes were started"):
        pretrain_packed([pack], TINY, CONFIG, tmp_path, processes=Processes(0, 2))


@pytest.fixture
def files(tmp_path: Path) -> Path:
    folder = tmp_path / "files"
    folder.mkdir()
    (folder / "large").write_bytes(np.random.default_rng(0).bytes(25_000))
    (folder / "small").write_bytes(b"a few")
    (folder / "empty").write_bytes(b"")
    return folder


def test_pieces_are_small_and_come_together_again(files: Path, tmp_path: Path) -> None:
    out, back = tmp_path / "pieces", tmp_path / "back"
    names = write_pieces(files, ("large", "small", "empty", "absent"), out, most_bytes=10_000)
    assert names == ["large.0", "large.1", "large.2", "small", "empty", MANIFEST]
    assert sorted(names) == sorted(one.name for one in out.iterdir())
    assert max(one.stat().st_size for one in out.iterdir()) <= 10_000
    assert join_pieces(out, back) == ["large", "small", "empty"]
    for name in ("large", "small", "empty"):
        assert (back / name).read_bytes() == (files / name).read_bytes()
    # A smaller file needs fewer pieces: the others do not stay behind.
    (files / "large").write_bytes(b"x" * 15_000)
    assert len(write_pieces(files, ("large",), out, most_bytes=10_000)) == 3
    assert sorted(one.name for one in out.iterdir()) == ["large.0", "large.1", MANIFEST]
    with pytest.raises(InvalidConfigError, match="most_bytes is 0"):
        write_pieces(files, ("large",), out, most_bytes=0)


def test_pieces_that_do_not_belong_together_are_refused(files: Path, tmp_path: Path) -> None:
    out, back = tmp_path / "pieces", tmp_path / "back"
    write_pieces(files, ("large", "small"), out, most_bytes=10_000)
    content = (out / "large.1").read_bytes()
    (out / "large.1").write_bytes(content[:-1] + b"?")
    with pytest.raises(InvalidResultError, match=r"large\.1: is not the piece that was written"):
        join_pieces(out, back)
    assert not back.exists()
    (out / "large.1").unlink()
    with pytest.raises(InvalidResultError, match="the piece is missing"):
        join_pieces(out, back)
    listed = (out / MANIFEST).read_text()
    (out / MANIFEST).write_text(listed.replace('"large.0"', '"../large.0"'))
    with pytest.raises(InvalidResultError, match="cannot be the name of a file"):
        join_pieces(out, back)
    (out / MANIFEST).write_text(listed[:100])
    with pytest.raises(InvalidResultError, match="not the list of a training's pieces"):
        join_pieces(out, back)


@pytest.mark.gpu
def test_a_gpu_learns_what_a_processor_learns(tmp_path: Path, pack: Path) -> None:
    """The same pictures but for the sensors' noise, the same steps: losses stay near each other."""
    runs = {}
    for device in ("cpu", "cuda"):
        pretrain_packed([pack], TINY, CONFIG, tmp_path / device, processes=Processes(device=device))
        rows = read_scalars(tmp_path / device)
        runs[device] = np.array([row["loss"] for row in rows if row["split"] == "train"])
    assert len(runs["cuda"]) == 6
    np.testing.assert_allclose(runs["cuda"], runs["cpu"], rtol=0.15)
