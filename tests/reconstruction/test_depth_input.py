"""What the network is asked: pictures, cameras, weights, and clear words when they are bad."""

import json

import cv2
import numpy as np
import pytest
import torch
import trimesh

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidRecordingError
from clothtrack.reconstruction.depth_input import from_depth, from_picture
from clothtrack.reconstruction.training.checkpoint import save_weights
from clothtrack_lab.published_networks.model import MeshReconstructor
from clothtrack_lab.published_networks.network_config import TINY_NETWORK


@pytest.fixture
def picture(tmp_path):
    """A towel of 20 cm, 10 mm thick so that it stands out, 0.7 m under a camera; millimeters."""
    depth = np.full((120, 160), 700, np.uint16)
    depth[38:82, 58:102] = 690
    path = tmp_path / "depth.png"
    cv2.imwrite(str(path), depth)
    return path


@pytest.fixture
def weights(tmp_path):
    """Untrained weights for a towel."""
    torch.manual_seed(0)
    path = tmp_path / "towel.safetensors"
    save_weights(
        path, MeshReconstructor(TINY_NETWORK, "towel").state_dict(), TINY_NETWORK, kind="towel"
    )
    return path


def test_a_depth_picture_becomes_a_mesh(picture, weights, tmp_path, capsys):
    words = ["reconstruct", str(picture), "--garment", "towel", "--weights", str(weights)]
    output = tmp_path / "out" / "mesh.ply"
    assert cli.main([*words, "--output", str(output), "--focal", "150", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    mesh = trimesh.load(output, process=False)
    assert len(mesh.vertices) == told["vertices"] > 100
    # However untrained the network is: a towel's size, on the table, in the camera's view.
    assert np.abs(mesh.vertices[:, :2]).max() < 0.6
    assert np.ptp(mesh.vertices[:, :2], axis=0).min() > 0.1
    assert -0.01 < mesh.vertices[:, 2].min() < mesh.vertices[:, 2].max() < 0.2


def test_a_mesh_is_named_after_its_picture_and_replaces_none_unasked(
    picture, weights, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    words = ["reconstruct", str(picture), "--garment", "towel", "--weights", str(weights)]
    words += ["--focal", "150", "--no-refined"]
    assert cli.main(words) == 0
    mesh = tmp_path / "out" / f"{picture.stem}.obj"
    mesh.write_text("mine")
    capsys.readouterr()
    assert cli.main(words) == 1
    said = capsys.readouterr().err
    assert f"out/{picture.stem}.obj: is there already" in said
    assert said.count("\n") == 1
    assert mesh.read_text() == "mine"
    assert cli.main([*words, "--force"]) == 0
    assert mesh.read_text() != "mine"


@pytest.mark.parametrize(
    "case",
    [
        ([], "add --garment"),
        (["--garment", "sofa"], "'sofa'"),
        (["--garment", "tshirt"], "is for 'towel'"),
        (["--garment", "towel", "--focal", "-1"], "focal is -1"),
        (["--garment", "towel", "--device", "tpu"], "use cpu, cuda"),
        (["--garment", "towel", "--depth-unit", "1.0"], "m away"),
        (["--garment", "towel", "--depth-unit", "inf"], "depth_unit is inf"),
        (["--garment", "towel", "--frame", "0"], "--frame: "),
        (["--garment", "towel", "--output", "mesh.dae"], "choose .obj, .ply, .stl or .glb"),
        (["--garment", "trousers", "--size", "0.5"], "--size WIDTH LENGTH"),
        (["--garment", "trousers", "--size", "0.5", "nan"], "the size is 0.5 x nan m"),
    ],
)
def test_bad_input_is_one_clear_line(picture, weights, tmp_path, capsys, case):
    words, told = case
    output = tmp_path / "mesh.obj"
    base = ["reconstruct", str(picture), "--weights", str(weights), "--output", str(output)]
    assert cli.main([*base, *words]) in (1, 2)
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize("option", ["--mask", "--depth-unit", "--focal", "--table-distance"])
def test_what_a_recording_says_itself_is_not_told_again(tmp_path, capsys, option):
    words = ["reconstruct", str(tmp_path), "--garment", "towel", option, "0.7"]
    assert cli.main([*words, "--output", str(tmp_path / "mesh.obj")]) == 1
    assert f"{option}: {tmp_path} is a recording" in capsys.readouterr().err


def test_a_picture_that_shows_nothing_is_refused(picture, tmp_path):
    empty, mask = tmp_path / "empty.png", tmp_path / "mask.png"
    cv2.imwrite(str(empty), np.zeros((20, 30), np.uint16))
    with pytest.raises(InvalidRecordingError, match="no pixel has a depth"):
        from_picture(empty)
    cv2.imwrite(str(mask), np.full((60, 80), 255, np.uint8))
    with pytest.raises(InvalidRecordingError, match="80 x 60"):
        from_picture(picture, mask=mask)
    thin = np.full((240, 320), 1.0)
    thin[75:165, 100:220] -= 0.001
    with pytest.raises(InvalidRecordingError, match=r"thin flat cloth needs one: --mask FILE"):
        from_depth(thin, "thin.png")
