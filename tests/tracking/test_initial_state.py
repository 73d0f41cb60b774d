"""Where tracking starts: template, network or flat fit, and what is said when one is missing."""

import json
import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction import availability
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording
from clothtrack.simulation.parameters import RESTING_HEIGHT_M
from clothtrack.tracking import initial_state
from clothtrack.tracking.configuration import InitialStateConfig, RunConfig
from clothtrack.tracking.initial_state import find_initial_state
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.filming import simulate

SHORT = (
    "search.method=none", "objective.iterations=20", "cloth.substep_s=3.3e-3",
    "initial_state.vertex_count=200",
)  # fmt: skip
FEW = InitialStateConfig(vertex_count=200)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Path:
    """A towel without a template, as a person would record it."""
    world = replace(SMALL_WORLD, template=None)
    return simulate(tmp_path_factory.mktemp("world"), "towel", 1, config=world)[0]


@pytest.fixture(scope="module")
def towels(filmed) -> Recording:
    return read_recording(filmed)


@pytest.fixture(scope="module")
def cloud(towels):
    return observe(towels, towels.frames[0])


@pytest.fixture(scope="module")
def seen(towels, cloud):
    return towels, cloud


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    """Untrained: bad, and a network like any other."""
    torch = pytest.importorskip("torch")
    from clothtrack.reconstruction.training.checkpoint import save_weights
    from clothtrack_lab.published_networks.model import MeshReconstructor
    from clothtrack_lab.published_networks.network_config import TINY_NETWORK

    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "towel.safetensors"
    save_weights(
        path, MeshReconstructor(TINY_NETWORK, "towel").state_dict(), TINY_NETWORK, kind="towel"
    )
    return path


@pytest.fixture
def none_shipped(tmp_path, monkeypatch) -> Path:
    """The package's folder of weights, empty."""
    folder = tmp_path / "shipped"
    folder.mkdir()
    monkeypatch.setattr(availability, "SHIPPED", folder)
    return folder


def with_cloth(recording: Recording, **changes: object) -> Recording:
    return replace(recording, cloth=replace(recording.cloth, **changes))


def test_the_template_wins_and_says_that_weights_are_not_used(towels, cloud, weights, caplog):
    template = garment("towel", vertex_count=120)
    recording = with_cloth(towels, template=template)
    first = find_initial_state(recording, cloud, replace(FEW, weights=str(weights)))
    assert first.mesh is template
    assert first.positions is None
    assert first.origin == {"source": "template"}
    assert "initial_state.source=network would ask it" in caplog.text


def test_without_weights_the_garment_is_fitted_flat_and_one_line_says_so(
    towels, cloud, none_shipped, monkeypatch, caplog
):
    with caplog.at_level(logging.INFO):
        first = find_initial_state(towels, cloud, FEW)
    assert first.origin == {"source": "flat"}
    assert first.positions is None
    assert caplog.text.count("\n") == 1
    assert "no weights for 'towel' come with this installation" in caplog.text
    # A crumpled one with a warning.
    monkeypatch.setattr(initial_state, "FLAT_MISFIT_M", 0.0)
    assert find_initial_state(towels, cloud, FEW).origin == {"source": "flat"}
    assert "does not match the first cloud" in caplog.text


def test_shipped_weights_are_used_when_they_are_there(
    towels, cloud, none_shipped, weights, monkeypatch
):
    (none_shipped / "tokens.safetensors").write_bytes(weights.read_bytes())
    # A cloth that lies flat is fitted: nothing of it is hidden.
    assert find_initial_state(towels, cloud, FEW).origin == {"source": "flat"}
    monkeypatch.setattr(initial_state, "FLAT_MISFIT_M", 0.0)
    first = find_initial_state(towels, cloud, FEW)
    assert first.origin["source"] == "network"
    assert first.positions is not None
    # The rest shape is a flat towel and not the network's first guess at one.
    flat = first.mesh
    size = tuple(float(side) for side in np.ptp(flat.canonical[:, :2], axis=0))
    np.testing.assert_allclose(
        flat.edge_lengths,
        garment("towel", vertex_count=200, size_m=size).edge_lengths,
        rtol=1e-4,
    )
    assert np.ptp(flat.vertices[:, 2]) < 1e-6
    height = towels.table.heights(flat.vertices).min()
    assert height == pytest.approx(RESTING_HEIGHT_M, abs=1e-6)
    # Both lie where the cloth was seen.
    middle = cloud.points[:, :2].mean(axis=0)
    for vertices in (flat.vertices, first.positions):
        # An untrained network is a towel's width off, and no more.
        assert np.linalg.norm(vertices[:, :2].mean(axis=0) - middle) < 0.2


def test_a_source_that_is_asked_for_is_the_source(towels, cloud, none_shipped, weights):
    shipped = none_shipped / "tokens.safetensors"
    shipped.write_bytes(weights.read_bytes())
    template = garment("towel", vertex_count=120)
    recording = with_cloth(towels, template=template)
    sources = {
        source: find_initial_state(recording, cloud, replace(FEW, source=source)).origin["source"]
        for source in ("auto", "template", "network", "flat")
    }
    assert sources == {
        "auto": "template", "template": "template", "network": "network", "flat": "flat",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("change", "config", "told"),
    [
        ({}, {"source": "template"}, "the recording has none"),
        ({}, {"source": "network"}, "no weights for 'towel'"),
        ({"kind": "other"}, {"source": "network"}, "cloth.kind is 'other'"),
        ({"held_vertices": {"g": np.array([1])}}, {}, "numbers of the template's vertices"),
    ],
)
def test_what_is_missing_is_named(seen, none_shipped, change, config, told):
    towels, cloud = seen
    with pytest.raises((InvalidRecordingError, InvalidConfigError), match=told):
        find_initial_state(with_cloth(towels, **change), cloud, replace(FEW, **config))


def test_a_missing_extra_is_named_or_passed_over(seen, none_shipped, weights, monkeypatch, caplog):
    towels, cloud = seen
    monkeypatch.setattr(availability, "EXTRA", ("no_such_module",))
    with pytest.raises(InvalidConfigError, match=r"no_such_module; install with: .*learn"):
        find_initial_state(towels, cloud, replace(FEW, weights=str(weights)))
    (none_shipped / "tokens.safetensors").write_bytes(weights.read_bytes())
    with caplog.at_level(logging.INFO):
        assert find_initial_state(towels, cloud, FEW).origin == {"source": "flat"}
    assert "no_such_module is not installed" in caplog.text


def test_tracking_starts_where_the_network_saw_the_cloth(filmed, weights, tmp_path, capsys):
    settings = [word for one in SHORT for word in ("--set", one)]
    words = [
        "track",
        str(filmed),
        "--output",
        str(tmp_path),
        "--weights",
        str(weights),
        *settings,
        "--force",
    ]
    assert cli.main([*words, "--json"]) == 0
    (outcome,) = json.loads(capsys.readouterr().out)
    tracked = TrackedTrajectory.load(Path(outcome["result"]))
    assert tracked.provenance["initial_state"]["source"] == "network"
    assert tracked.provenance["initial_state"]["weights"] == "towel.safetensors"
    recording = read_recording(filmed)
    config = RunConfig().initial_state
    first = find_initial_state(
        recording,
        observe(recording, recording.frames[0]),
        replace(config, vertex_count=200, weights=str(weights)),
    )
    # It is aligned to the cloud before anything moves.
    assert not np.array_equal(tracked.positions[0], first.positions)
    np.testing.assert_allclose(tracked.mesh.vertices, first.mesh.vertices, atol=1e-6)
    assert np.isfinite(tracked.positions).all()
    # The same words again find it finished; other weights are other settings.
    assert cli.main(words) == 0
    assert "finished before" in capsys.readouterr().out
    assert cli.main([*words[:4], *settings]) == 1
    assert "tracked with other settings" in capsys.readouterr().err


def test_weights_that_are_not_there_are_refused_even_beside_a_template(tmp_path, capsys):
    missing = tmp_path / "none.safetensors"
    arguments = ["track", str(shipped_recording()), "--output", str(tmp_path / "out")]
    assert cli.main([*arguments, "--weights", str(missing)]) == 1
    assert "no such weights file" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


WITHOUT_TORCH = """
import sys
from dataclasses import replace
from pathlib import Path
from clothtrack.reconstruction import availability
availability.SHIPPED = Path(sys.argv[2])
from clothtrack.cli.command_line import main
code = main(["track", sys.argv[1], "--output", sys.argv[3], *sys.argv[4:]])
loaded = {"torch", "safetensors", "skimage", "igl"} & set(sys.modules)
print(code, sorted(loaded))
"""


@pytest.mark.slow
def test_torch_stays_where_it_is_unless_the_network_is_used(filmed, none_shipped, tmp_path):
    settings = [word for one in SHORT for word in ("--set", one)]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, str(filmed), str(none_shipped),
         str(tmp_path / "out"), *settings],
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "0 []"
