"""Every artifact is told by its content, and damage by the checksums of its format."""

import json
import shutil

import numpy as np
import pytest

import clothtrack as ct
import clothtrack_lab as lab
from clothtrack.cli.command_line import main
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.state_store import StateShard, write_states
from clothtrack_lab.published_networks.registered import SHIPPED


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Folder with recordings/ and truth/ of one napkin, folded once."""
    folder = tmp_path_factory.mktemp("world")
    lab.simulate(folder, "towel", 1, seed=3, small=True)
    return folder


@pytest.fixture(scope="module")
def run(world):
    """Tracked by the dynamics alone, which is quick."""
    return ct.track(world / "recordings" / "towel_0003", mode="open_loop", settings=("seed=7",))


@pytest.fixture
def artifacts(run, world, tmp_path):
    """One of each kind, by its kind; to be damaged."""
    shutil.copytree(world / "recordings", tmp_path / "recordings")
    shutil.copytree(world / "truth", tmp_path / "truth")
    run.save(tmp_path / "towel.zarr")
    ct.label(run, tmp_path / "towel.labels.npz")
    mesh = garment("towel", vertex_count=60)
    positions = np.stack([mesh.vertices] * 2).astype(np.float32)
    shard = StateShard("towel", mesh, positions, np.zeros(2, np.int32), ("flat", "drop"), 3)
    write_states(tmp_path / "states", "towel", [shard], {})
    shutil.copy(SHIPPED / "towel.safetensors", tmp_path)
    return {
        "recording": tmp_path / "recordings" / "towel_0003",
        "truth": tmp_path / "truth" / "towel_0003.npz",
        "tracked trajectory": tmp_path / "towel.zarr",
        "labels": tmp_path / "towel.labels.npz",
        "states": tmp_path / "states",
        "shard of states": tmp_path / "states" / "shards" / "0000.zarr",
        "weights": tmp_path / "towel.safetensors",
    }


def test_whole_artifacts_are_known_and_damaged_ones_told_in_one_line(artifacts, capsys):
    paths = list(map(str, artifacts.values()))
    assert main(["inspect", *paths]) == 0
    lines = capsys.readouterr().out.splitlines()
    for kind, path in artifacts.items():
        begin = f"{path}: a valid {kind}" if kind == "recording" else f"{path}   ok: {kind}"
        assert [line for line in lines if line.startswith(begin)], begin
    for kind, path in artifacts.items():
        if kind == "states":
            continue  # its shard is one of the others
        files = [one for one in path.rglob("*") if one.is_file()] or [path]
        # The largest file of each: pictures, chunks, archives.
        largest = max(files, key=lambda one: (one.suffix == ".png", one.stat().st_size))
        content = bytearray(largest.read_bytes())
        content[len(content) // 2] ^= 255
        largest.write_bytes(content)
    assert main(["inspect", *paths, "--json"]) == 1
    told = capsys.readouterr()
    assert told.err == ""
    for one, (kind, path) in zip(json.loads(told.out), artifacts.items(), strict=True):
        assert (one["path"], one["kind"], one["ok"]) == (str(path), kind, False)
        assert one["problems"]
        assert "\n" not in one["problems"][0]


def test_a_shard_that_is_listed_and_gone_is_missed(artifacts):
    folder = artifacts["states"]
    document = json.loads((folder / "states.json").read_text())
    made = {"states": 1, "cpu_s": None}
    document["shards"] = {"0000.zarr": made, "0001.zarr": made}
    (folder / "states.json").write_text(json.dumps(document))
    assert ct.verify(folder).problems == ("shards/0001.zarr is missing",)


def test_each_trajectory_of_the_benchmark_is_read(artifacts, tmp_path):
    listed = {"trajectories": [{"name": "towel_0003"}]}
    (tmp_path / "bench.json").write_text(json.dumps(listed))
    assert ct.verify(tmp_path).ok
    artifacts["truth"].unlink()
    assert "towel_0003: " in str(ct.verify(tmp_path))
    del listed["trajectories"][0]["name"]
    (tmp_path / "bench.json").write_text(json.dumps(listed))
    assert "not a list of trajectories" in str(ct.verify(tmp_path))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nothing.zarr", "no such file or folder; inspect takes"),
        ("nothing.npz", "no such file; inspect takes"),
        ("empty.npz", "cannot be read as a truth file"),
        ("empty.labels.npz", "not whole pseudo-labels"),
        ("empty.safetensors", "not a whole safetensors file"),
        ("empty.zarr", "not a tracked trajectory"),
        ("empty.txt", "nothing that can be told"),
    ],
)
def test_what_is_none_is_told_without_a_traceback(name, words, tmp_path, capsys):
    if name == "empty.zarr":
        (tmp_path / name).mkdir()
    elif name.startswith("empty"):
        (tmp_path / name).touch()
    assert main(["inspect", str(tmp_path / name)]) == 1
    told = capsys.readouterr().out
    assert words in told
    known = "not known" if "inspect takes" in words or "can be told" in words else "damaged"
    assert f"{name}   {known}: " in told
    assert told.count("\n") == 1
