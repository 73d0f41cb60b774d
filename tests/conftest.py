"""What every test can rely on: the same seeds, a quiet Warp, one thread, a small recording.

The recording is right in everything, for tests to break in one place.
"""

import json
import os
import random
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import (
    ClothDescription,
    ObservedRegion,
    PickerPath,
    Recording,
    Table,
)
from clothtrack.recordings.store import RecordingWriter, read_recording

quiet_warp()


@pytest.fixture(autouse=True)
def _same_seeds():
    """Libraries that draw from the global generators draw the same numbers in every run."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002


@pytest.fixture
def rng():
    """A seeded generator of the test's own."""
    return np.random.default_rng(0)


# Looks straight down from 0.6 m: camera x = world x, camera y = -world y, camera z = -world z.
DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1]])


@pytest.fixture
def camera():
    """A small camera that looks straight down from 0.6 m."""
    return Camera("top", 64, 48, 60.0, 60.0, 31.5, 23.5, DOWN)


@pytest.fixture
def table():
    """The plane z = 0."""
    return Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


@pytest.fixture
def square():
    """Two triangles, with canonical coordinates."""
    vertices = np.array([[0.0, 0, 0.1], [0.1, 0, 0.1], [0.1, 1 / 30, 0.1], [0, 0.1, 0.1]])
    return ClothMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), vertices - 0.05)


@pytest.fixture
def write(camera, table, square):
    """Writes a valid recording of five frames and two actions to a folder."""

    def writer(folder: Path) -> Recording:
        rng = np.random.default_rng(0)
        with RecordingWriter(
            folder,
            [camera],
            {"top": 0.001},
            table=table,
            cloth=ClothDescription(
                "towel", "blue", (0.1, 0.1), square, {"arm": np.array([0], dtype=np.int64)}
            ),
            observed=ObservedRegion(0.05, 0.02),
            provenance={"made_by": "test"},
        ) as recording:
            for frame in range(5):
                mask = np.zeros((48, 64), dtype=bool)
                mask[10:30, 20:40] = True
                recording.add_frame(
                    0.5 * frame,
                    color={"top": rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)},
                    depth={"top": rng.integers(490, 511, (48, 64)) / 1000.0},
                    mask={"top": mask},
                )
            recording.set_picker_path(
                "arm",
                PickerPath(
                    np.array([0.0, 1.0, 2.0]),
                    np.array([[0.0, 0, 0.1], [0.1, 0, 1 / 7], [0.1, 0, 0.3]]),
                    np.array([True, True, False]),
                ),
            )
            recording.add_action(0, 2, ["arm"])
            recording.add_action(2, 4, ["arm"])
        return read_recording(folder)

    return writer


@pytest.fixture(scope="session")
def napkin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of `SMALL_WORLD`, simulated once per process, for tests that only read it.

    Its truth is in `truth/` beside the folder `recordings/` that it is in.
    """
    pytest.importorskip("mujoco", reason="the extra [lab] brings it")
    from clothtrack_lab.world.episodes import SMALL_WORLD
    from clothtrack_lab.world.filming import simulate

    (folder,) = simulate(tmp_path_factory.mktemp("napkin"), "towel", 1, config=SMALL_WORLD)
    return folder


@pytest.fixture
def edit():
    """Changes recording.json of a folder through a function."""

    def editor(folder: Path, change) -> None:
        path = folder / "recording.json"
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    return editor


@pytest.fixture
def data():
    """Folder of the real recordings; the test is skipped where there is none."""
    beside = Path(__file__).parents[1] / ".." / "shared" / "data"
    folder = Path(os.environ.get("CLOTHTRACK_DATA", beside))
    if not (folder / "hanging-cloth-rgbd").is_dir():
        pytest.skip("real recordings are not here; set CLOTHTRACK_DATA to their folder")
    return folder
