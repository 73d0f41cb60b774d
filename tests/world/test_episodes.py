"""A tiny world, filmed end to end: a valid recording, a repeatable truth, and a wall between."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import trousers
from clothtrack.garments.outlines import TrousersOutline
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.template_file import write_template
from clothtrack.simulation.pick_and_place import ActionConfig
from clothtrack_lab.world.episodes import SMALL_WORLD, TemplateConfig
from clothtrack_lab.world.filming import simulate

TINY = replace(
    SMALL_WORLD,
    vertex_count=150,
    template=TemplateConfig(vertex_count=100),
    action=ActionConfig(),
    sensor=SensorConfig(width=80, height=60, focal=75.0),
)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("world")
    simulate(folder, "towel", 1, seed=3, config=TINY)
    return folder


def test_recording_is_valid_and_complete(out: Path) -> None:
    recording = read_recording(out / "recordings" / "towel_0003")
    assert recording.cloth.kind == "towel"
    assert recording.cloth.size_m == (0.2, 0.2)
    assert recording.cloth.template is not None
    assert recording.cloth.template.canonical is not None
    assert recording.table is not None
    (action,) = recording.actions
    assert (action.first_frame, action.last_frame) == (0, len(recording.frames) - 1)
    assert np.allclose(np.diff([frame.time_s for frame in recording.frames]), 0.05)


def test_a_print_changes_nothing_but_the_color_pictures(out: Path, tmp_path: Path) -> None:
    simulate(tmp_path, "towel", 1, seed=3, config=replace(TINY, printed=True))
    plain, printed = (each / "recordings" / "towel_0003" for each in (out, tmp_path))
    files = [each.relative_to(plain) for each in plain.rglob("*") if each.is_file()]
    assert sorted(files) == sorted(
        each.relative_to(printed) for each in printed.rglob("*") if each.is_file()
    )
    for each in files:
        same = (plain / each).read_bytes() == (printed / each).read_bytes()
        assert same == ("color" not in each.parts), each
    truths = [(each / "truth" / "towel_0003.npz").read_bytes() for each in (out, tmp_path)]
    assert truths[0] == truths[1]


def test_a_garment_of_its_own_template_is_filmed(tmp_path: Path) -> None:
    legs = trousers(TrousersOutline(), 0.3, vertex_count=150)
    # A template may lie anywhere in its own frame.
    write_template(legs.with_vertices(legs.vertices + (0.5, -0.2, 0.0)), tmp_path / "legs.npz")
    own = replace(TINY, size_m=None, garment=str(tmp_path / "legs.npz"))
    (folder,) = simulate(tmp_path, "tshirt", 1, seed=3, config=own)
    cloth = read_recording(folder).cloth
    width, length = np.ptp(legs.vertices[:, :2], axis=0)
    assert cloth.size_m == pytest.approx((width, length))
    assert cloth.template is not None
    np.testing.assert_array_equal(cloth.template.faces, legs.faces)
    truth = np.load(tmp_path / "truth" / "tshirt_0003.npz")["positions"]
    assert np.linalg.norm(truth[0] - cloth.template.vertices, axis=1).mean() < 0.01
    with pytest.raises(InvalidConfigError, match="two layers, and the garment is 'towel'"):
        simulate(tmp_path, "towel", 1, config=own)


def test_nothing_of_the_truth_is_in_the_recording(out: Path) -> None:
    folder = out / "recordings" / "towel_0003"
    allowed = {"recording.json", "picker.csv", "template.obj", "template_canonical.csv"}
    for path in folder.rglob("*"):
        inside = path.relative_to(folder)
        assert path.is_dir() or str(inside) in allowed or inside.parts[0] in {"color", "depth"}
    text = (folder / "recording.json").read_text()
    truth = np.load(out / "truth" / "towel_0003.npz")
    fabric = json.loads(str(truth["fabric"]))
    assert not any(name in text for name in fabric)
    assert repr(fabric["table_friction"]) not in text
    template = read_recording(folder).cloth.template
    assert template is not None
    assert len(template.vertices) != truth["positions"].shape[1]
    apart = np.linalg.norm(template.vertices[:, None] - truth["positions"][0][None], axis=2)
    assert apart.min() > 1e-6


def test_same_seed_gives_the_same_bytes(out: Path, tmp_path: Path) -> None:
    simulate(tmp_path, "towel", 1, seed=3, config=TINY)
    for name in ("truth/towel_0003.npz", "recordings/towel_0003/picker.csv"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()
    last = max((out / "recordings/towel_0003/depth").iterdir()).name
    again = tmp_path / "recordings/towel_0003/depth" / last
    assert again.read_bytes() == (out / "recordings/towel_0003/depth" / last).read_bytes()
