"""What the network is asked: pictures, cameras, weights, and clear words when they are bad."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import trimesh

import clothtrack
from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidRecordingError, InvalidResultError
from clothtrack.reconstruction.availability import SHIPPED
from clothtrack.reconstruction.depth_input import from_depth, from_picture
from clothtrack.reconstruction.model_loading import load_model
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


def test_the_table_is_found_and_the_cloth_on_it(picture):
    given = from_picture(picture, focal=150.0)
    assert given.camera.position[2] == pytest.approx(0.7, abs=1e-6)
    points = given.camera.back_project(given.depth_m, given.mask)
    np.testing.assert_allclose(points[:, 2], 0.01, atol=1e-6)
    np.testing.assert_allclose(np.ptp(points[:, :2], axis=0), 43 * 0.69 / 150, atol=0.005)


def test_an_empty_picture_is_refused(tmp_path):
    path = tmp_path / "empty.png"
    cv2.imwrite(str(path), np.zeros((20, 30), np.uint16))
    with pytest.raises(InvalidRecordingError, match="no pixel has a depth"):
        from_picture(path)


def test_a_mask_of_another_size_is_refused(picture, tmp_path):
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.full((60, 80), 255, np.uint8))
    with pytest.raises(InvalidRecordingError, match="80 x 60"):
        from_picture(picture, mask=mask)


def test_weights_come_whole_or_not_at_all(weights):
    assert load_model("towel", weights).network.config == TINY_NETWORK
    with pytest.raises(InvalidResultError, match="is for 'towel'"):
        load_model("tshirt", weights)
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(InvalidResultError, match="not a whole"):
        load_model("towel", weights)


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
        (["--garment", "towel", "--focal", "-1"], "focal is -1"),
        (["--garment", "towel", "--device", "tpu"], "use cpu, cuda"),
        (["--garment", "towel", "--depth-unit", "1.0"], "m away"),
    ],
)
def test_bad_input_is_one_clear_line(picture, weights, tmp_path, capsys, case):
    words, told = case
    output = tmp_path / "mesh.obj"
    base = ["reconstruct", str(picture), "--weights", str(weights), "--output", str(output)]
    assert cli.main([*base, *words]) == 1
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [("--mask", "mask.png"), ("--depth-unit", "0.001"), ("--focal", "200"),
     ("--table-distance", "0.7")],
)  # fmt: skip
def test_what_a_recording_says_itself_is_not_told_again(tmp_path, capsys, option, value):
    words = ["reconstruct", str(tmp_path), "--garment", "towel", option, value]
    assert cli.main([*words, "--output", str(tmp_path / "mesh.obj")]) == 1
    assert f"{option}: {tmp_path} is a recording" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--frame", "0"], "--frame: "),
        (["--depth-unit", "inf"], "depth_unit is inf"),
        (["--output", "mesh.dae"], "choose .obj, .ply, .stl or .glb"),
    ],
)
def test_options_that_mean_nothing_are_refused(picture, weights, capsys, words, told):
    base = ["reconstruct", str(picture), "--garment", "towel", "--weights", str(weights)]
    assert cli.main([*base, *words]) == 1
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


def test_shipped_weights_are_where_the_package_packs_them():
    packed = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    patterns = packed["tool"]["setuptools"]["package-data"]["clothtrack"]
    assert str(SHIPPED.relative_to(Path(clothtrack.__file__).parent) / "*") in patterns


def test_weights_of_another_preset_are_refused(picture, tmp_path, capsys):
    path = tmp_path / "towel.safetensors"
    other = replace(TINY_NETWORK, decoder_hidden=32)
    save_weights(path, MeshReconstructor(TINY_NETWORK, "towel").state_dict(), other, kind="towel")
    words = ["reconstruct", str(picture), "--garment", "towel", "--weights", str(path)]
    assert cli.main([*words, "--output", str(tmp_path / "mesh.obj")]) == 1
    assert "another preset" in capsys.readouterr().err
    assert not (tmp_path / "mesh.obj").exists()


def test_a_thin_flat_cloth_without_a_mask_needs_one():
    depth = np.full((240, 320), 1.0)
    depth[75:165, 100:220] -= 0.001
    with pytest.raises(InvalidRecordingError, match=r"thin flat cloth needs one: --mask FILE"):
        from_depth(depth, "thin.png")
