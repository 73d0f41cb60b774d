"""Trousers through the verb: from a PNG and from a recording, of known and unknown size."""

import json

import cv2
import numpy as np
import pytest
import torch

import clothtrack as ct
from clothtrack.cli import command_line as cli
from clothtrack.garments.garment_meshes import trousers
from clothtrack.garments.outlines import TrousersOutline
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.cuts import cuts
from clothtrack.reconstruction.tokens.token_learning import KIND, PREFIX
from clothtrack.reconstruction.tokens.token_network import TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.training.checkpoint import save_weights
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.recordings.store import RecordingWriter
from clothtrack.recordings.template_file import write_template

POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 1.0
CAMERA = Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5, POSE)
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


@pytest.fixture(autouse=True)
def _short_search(monkeypatch):
    """One turn of the picture and few sizes say all that is asked here."""
    for name, value in {"ENOUGH": np.inf, "SCANNED_SIZES": (1.15,), "STEPS": (0.2,)}.items():
        monkeypatch.setattr(f"clothtrack.reconstruction.search.{name}", value)


@pytest.fixture(scope="module")
def flat():
    return trousers(TrousersOutline(), 0.9, vertex_count=600)


@pytest.fixture(scope="module")
def size_m(flat):
    width, length = np.ptp(flat.canonical[:, :2], axis=0)
    return float(width), float(length)


@pytest.fixture(scope="module")
def drawn(flat):
    """Depth [m] of the trousers, one leg folded over the other, and where they are."""
    left = flat.vertices[:, 0] < 0.0
    layer = 0.005 + 0.002 * np.sign(flat.canonical[:, 2])
    level = flat.vertices[:, :2] * np.where(left, -1.0, 1.0)[:, None] ** (1, 0)
    folded = np.column_stack([level, np.where(left, 0.02 - layer, layer)])
    depth = Rasterizer(flat.faces, CAMERA).render(folded).depth
    return np.where(np.isfinite(depth), depth, 1.0), np.isfinite(depth)


@pytest.fixture(scope="module")
def picture(drawn, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trousers")
    depth, seen = drawn
    cv2.imwrite(str(folder / "depth.png"), np.rint(1e4 * depth).astype(np.uint16))
    cv2.imwrite(str(folder / "mask.png"), np.where(seen, 255, 0).astype(np.uint8))
    return folder / "depth.png"


@pytest.fixture(scope="module")
def untrained(tmp_path_factory):
    """Weights of a token network that is quickly asked."""
    torch.manual_seed(0)
    network = TokenNetwork(TokenNetworkConfig(width=16, layers=1, hypotheses=1))
    tensors = {PREFIX + name: value for name, value in network.state_dict().items()}
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    save_weights(path, tensors, network.config, kind=KIND)
    return path


def asked(picture, *words):
    mask = picture.with_name("mask.png")
    return ["reconstruct", str(picture), "--mask", str(mask), "--focal", "300",
            "--depth-unit", "0.0001", "--no-refined", *map(str, words)]  # fmt: skip


def vertices_of(mesh):
    return mesh.read_text().count("\nv ") + mesh.read_text().startswith("v ")


@pytest.mark.slow
def test_trousers_of_unknown_size_are_said_to_be_some_of_some_size(
    picture, untrained, tmp_path, capsys
):
    mesh = tmp_path / "mesh.obj"
    words = asked(picture, "--garment", "trousers", "--weights", untrained, "--output", mesh)
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    taken = said.partition(" taken for ")[2].split()
    assert taken[0] in [cut.cut for cut in cuts("trousers", 400)]
    assert 0.0 < float(taken[2]) < 3.0 > float(taken[4]) > 0.0
    assert f"{vertices_of(mesh)} vertices" in said


def test_a_template_says_how_the_trousers_are_cut(picture, flat, untrained, tmp_path, capsys):
    template, mesh = tmp_path / "trousers.npz", tmp_path / "mesh.obj"
    write_template(flat, template)
    words = ["--garment", "trousers", "--template", template, "--weights", untrained]
    assert cli.main(asked(picture, *words, "--output", mesh, "--json")) == 0
    said = json.loads(capsys.readouterr().out)
    assert vertices_of(mesh) == said["vertices"] == flat.vertex_count
    assert said["garment"][0]["cut"] == "template"


def test_a_recording_says_that_it_shows_trousers(drawn, size_m, untrained, tmp_path):
    depth, seen = drawn
    cloth = ClothDescription("trousers", size_m=size_m)
    folder = tmp_path / "recording"
    with RecordingWriter(folder, [CAMERA], {"top": 0.0001}, table=TABLE, cloth=cloth) as film:
        film.add_frame(0.0, depth={"top": depth}, mask={"top": seen})
    mesh = ct.reconstruct(folder, weights=untrained, refined=False)
    np.testing.assert_allclose(np.ptp(mesh.canonical[:, :2], axis=0), size_m, rtol=1e-6)
    # Of two layers: a towel or a part of them would have none of these.
    assert np.ptp(mesh.canonical[:, 2]) > 0.05 * size_m[0]
