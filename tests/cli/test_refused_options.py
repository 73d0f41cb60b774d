"""Options that cannot be meant: one line with the value and the limit, and nothing is written."""

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.reconstruction.availability import shipped_weights

REFUSED = {
    "simulate OUT --states 5 --seed -1": "the seed is -1; it must be at least 0",
    "simulate OUT --small --seed -1": "the seed is -1; it must be at least 0",
    "simulate OUT --states 5 --set vertex_count=5": "vertex_count is 5; it must be at least 50",
    "simulate OUT --benchmark dev --seed 4": "leave --seed out",
    "simulate OUT --benchmark dev --garment tshirt": "leave --garment out",
    "pretrain STATES --output OUT --hours -1": "the hours are -1; give a number above 0",
    "pretrain STATES --output OUT --hours 1 --set network.width=7": "it must be a multiple of 2",
    "pretrain STATES --output OUT --hours 1 --set network.image_size=100": "a multiple of 8",
    "finetune WEIGHTS EMPTY --output OUT": "EMPTY: no *.labels.npz",
    "finetune WEIGHTS LABELS --output OUT --set network.layers=6": "cannot be set here",
    "reconstruct x.png --garment towel --size 40 40": "40 x 40 m; give width and length in meters",
    "reconstruct x.png --garment towel": "x.png: there is no such picture file; check the name",
    "garment x.png --kind towel --output t.npz": "x.png: there is no such picture file",
    "garment x.png --kind towel --output t.npz --vertices 3": "--vertices is 3; it must be",
    "evaluate RUNS --recordings EMPTY": "name those in it: RUNS/*.zarr",
    "reconstruct x.png --garment towl": "choose from towel, trousers, tshirt; clothtrack",
    "inspect LABELS": "name them: LABELS/*.npz",
    "flatten OUT --dynamics-weights WEIGHTS": "add --dynamics mesh",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    inside = tmp_path_factory.mktemp("refused")
    small = ("vertex_count=60", "episodes=1", "crumpling.states=2", "crumpling.rest_limit_s=0.1")
    settings = [part for one in small for part in ("--set", one)]
    assert cli.main(["simulate", str(inside / "STATES"), "--states", "4", *settings]) == 0
    for name in ("EMPTY", "LABELS", "RUNS/one.zarr"):
        (inside / name).mkdir(parents=True)
    (inside / "LABELS" / "one.labels.npz").write_bytes(b"")
    (inside / "WEIGHTS").symlink_to(shipped_weights())
    return inside


@pytest.mark.parametrize("words", REFUSED)
def test_an_option_that_cannot_be_meant_is_refused(words, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert cli.main(words.split()) in (1, 2)
    said = capsys.readouterr().err
    assert REFUSED[words] in said
    assert said.count("\n") == 1
    assert not (folder / "OUT").exists()
