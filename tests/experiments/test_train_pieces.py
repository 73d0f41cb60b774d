"""States are packed, and a training runs in pieces that are carried from folder to folder."""

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="the extra [learn] brings it")

from tables import pack_states, train_pieces

from clothtrack.garments import garment
from clothtrack.reconstruction import write_states
from clothtrack.reconstruction.data.state_store import StateShard
from clothtrack.reconstruction.tokens.packed_states import read_pack
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor


def states_of(folder, kind, count=3):
    """Garments of one kind, each flat in three places."""
    shards = []
    for number in range(count):
        mesh = garment(kind, vertex_count=200, seed=number)
        flat = np.asarray(mesh.vertices, np.float32)
        flat = flat - [0.0, 0.0, flat[:, 2].min() - 0.002]
        positions = np.stack([flat + [0.1 * one, 0.0, 0.0] for one in range(3)]).astype(np.float32)
        shards.append(StateShard(kind, mesh, positions, np.arange(3), ("flat",) * 3, number))
    write_states(folder, kind, shards, {})
    return str(folder)


@pytest.fixture(scope="module")
def packs(tmp_path_factory):
    out = tmp_path_factory.mktemp("packs")
    folders = [states_of(out / kind, kind) for kind in ("towel", "tshirt")]
    assert pack_states.main([*folders, "--output", str(out / "packs"), "--most-mib", "0.03"]) == 0
    return [str(file) for file in sorted((out / "packs").iterdir())]


def options(packs, folder, **others):
    given = {
        "output": folder / "pieces", "folder": folder / "run", "device": "cpu", "width": 16,
        "layers": 1, "batch-size": 4, "held-out-share": 0.01, "evaluate-examples": 8,
        "piece-mib": 0.05, "fall-examples": 16, "copy-seconds": 0, **others,
    }  # fmt: skip
    words = [word for name, value in given.items() for word in (f"--{name}", str(value))]
    return ["--packs", *packs, *words]


def test_a_file_has_garments_of_all_kinds(packs):
    assert len(packs) > 1
    states, provenance = read_pack(Path(packs[0]))
    assert set(states.layers.tolist()) == {1, 2}
    assert [one["kind"] for one in provenance["sets"]] == ["towel", "tshirt"]


@pytest.mark.slow
def test_a_training_goes_on_elsewhere_from_its_pieces(packs, tmp_path, capsys):
    first, second = tmp_path / "first", tmp_path / "second"
    # No time is left after what the end takes: one step.
    assert train_pieces.main(options(packs, first, seconds=1)) == 0
    said = capsys.readouterr().out
    assert "paused after 1 steps, 4 examples" in said
    pieces = list((first / "pieces").iterdir())
    assert len(pieces) > 5
    assert max(one.stat().st_size for one in pieces) <= 0.05 * 2**20
    words = options(packs, second, pieces=first / "pieces", seconds=300)
    assert train_pieces.main(words) == 0
    said = capsys.readouterr().out
    assert "finished after 4 steps, 16 examples" in said
    assert [int(one) for one in re.findall(r"(\d+) examples: held out", said)][-1] == 16
    third = tmp_path / "third"
    words = ["--join", "--pieces", str(second / "pieces"), "--folder", str(third)]
    assert train_pieces.main(words) == 0
    assert TokenReconstructor.load(third / "model.safetensors").model.config.width == 16


@pytest.mark.slow
def test_what_rendering_and_learning_cost_is_said(packs, tmp_path, capsys):
    words = [*options(packs, tmp_path), "--measure", "2", "4", "--repeats", "1"]
    assert train_pieces.main(words) == 0
    said = capsys.readouterr().out
    assert "see cloth in the same 100.00 % of the pixels" in said
    rows = re.findall(r"batch (\d): render ([\d.]+) ms, learn ([\d.]+) ms an example", said)
    assert [int(size) for size, *_ in rows] == [2, 4]
    assert all(float(one) > 0.0 for row in rows for one in row[1:])
    assert not (tmp_path / "run").exists()


def test_wrong_options_are_refused_in_words(packs, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        train_pieces.main([])
    assert "give --packs FILE..., or --join" in capsys.readouterr().err
    missing = ["--join", "--pieces", str(tmp_path), "--folder", str(tmp_path / "run")]
    assert train_pieces.main(missing) == 1
    assert "there is no such file" in capsys.readouterr().err
