"""The small world that proofs of reliability work on: made once, by the verbs themselves."""

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from clothtrack.errors import ClothTrackError
from shared.trial import run

TOWEL = (
    "size_m=[0.2, 0.2]", "vertex_count=120", "template.vertex_count=100", "sensor.width=80",
    "sensor.height=60", "sensor.focal=75", "action.frame_rate=10",
    "action.distance_m=[0.08, 0.12]", "action.reach_m=0.1",
)  # fmt: skip
STATES = (
    "vertex_count=120", "episodes=2", "crumpling.states=2", "crumpling.rest_limit_s=0.2",
)  # fmt: skip
TRAINING = (
    "tokens.epochs=2", "tokens.batch_size=2", "tokens.held_out_share=0.5", "tokens.save_steps=1",
    "tokens.log_steps=1", "tokens.decay=cosine",
)  # fmt: skip
SMALL_NETWORK = ("network.width=16", "network.layers=1", "network.image_size=32")
ROLL_OUTS = (
    "roll_outs.vertex_count=150", "roll_outs.starts=1", "roll_outs.actions=4",
    "roll_outs.coarse.spacing_m=0.035", "roll_outs.motion.speed=0.8",
    "roll_outs.motion.rest_s=0.1", "roll_outs.states.crumpling.states=1",
    "roll_outs.states.crumpling.rest_limit_s=0.2",
)  # fmt: skip
FAST = ("search.method=none",)

MAKERS = Path(__file__).parents[2] / "tests" / "importing" / "makers.py"


def settings(*changes: str) -> list[str]:
    """Return settings as words of the command line."""
    return [word for change in changes for word in ("--set", change)]


def small_garments() -> None:
    """In a child: what robots and benchmark film is the small towel."""
    from clothtrack.files import with_settings
    from clothtrack_lab.world import SMALL_WORLD, bench, simulated_robot

    tiny, usual = with_settings(replace(SMALL_WORLD, actions=1), TOWEL), bench.vary
    names = ("size_m", "vertex_count", "actions", "template", "sensor", "action")
    changes = {name: getattr(tiny, name) for name in names}
    simulated_robot.vary = lambda *drawn: replace(usual(*drawn), **changes)
    two = [
        bench.BenchTrajectory(f"towel_dev_{n:02d}", "towel", "dev", 1000 + 6 * n, changes=changes)
        for n in range(2)
    ]
    bench.trajectories = lambda *_, **__: two


def makers() -> object:
    """Return the module of the tests that writes recordings in the formats of other programs."""
    if "import_makers" not in sys.modules:
        spec = importlib.util.spec_from_file_location("import_makers", MAKERS)
        assert spec is not None
        assert spec.loader is not None
        sys.modules["import_makers"] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules["import_makers"])
    return sys.modules["import_makers"]


def prepared(folder: Path) -> Path:
    """Make what is missing of the small world; gives its folder.

    Raises:
        ClothTrackError: a verb failed; its complaint.
    """
    folder.mkdir(parents=True, exist_ok=True)
    world, tracked = folder / "world", folder / "tracked"
    towels = [world / "recordings" / f"towel_{n:04d}" for n in (1, 2)]
    wanted: list[tuple[Path, Sequence[object], Callable[[], None] | None]] = [
        (towels[-1], ["simulate", world, "--trajectories", 2, "--actions", 1, "--seed", 1,
                      *settings(*TOWEL)], None),
        (tracked / "towel_0002.zarr", ["track", *towels, "--output", tracked, *settings(*FAST)],
         None),
        (folder / "labels" / "towel_0002.labels.npz",
         ["label", tracked / "towel_0001.zarr", tracked / "towel_0002.zarr", "--recordings",
          world / "recordings", "--output", folder / "labels"], None),
        (folder / "states" / "README.md", ["simulate", folder / "states", "--states", 8,
                                           *settings(*STATES)], None),
        (folder / "network" / "model.safetensors",
         ["pretrain", folder / "states", "--output", folder / "network",
          *settings(*TRAINING, *SMALL_NETWORK)], None),
        (folder / "episodes" / "towel_0003.html",
         ["flatten", folder / "episodes", "--policy", "heuristic", "--actions", 1, "--seed", 3],
         small_garments),
    ]  # fmt: skip
    for made, words, before in wanted:
        if not made.exists():
            done = run(words, folder, before=before)
            if done.code != 0:
                raise ClothTrackError(f"{words[0]}: {done.code}: {' '.join(done.complaints)}")
    _write_bags(folder / "bags")
    return folder


def _write_bags(folder: Path) -> None:
    """Three frames in formats of other programs, and the lens that one of them lacks."""
    if folder.exists():
        return
    folder.mkdir()
    make = makers()
    film = make.Film(frames=3, width=16, height=12)
    one, two = make.Messages(cdr=False), make.Messages(cdr=True)
    make.write_ros1(folder / "ros1.bag", make.stream(film, one), one)
    make.write_ros2(folder / "mcap", make.stream(film, two), two)
    make.write_ros2(folder / "sqlite", make.stream(film, two), two, storage="sqlite3")
    make.write_realsense_bag(folder / "realsense.bag", film)
    make.write_folder(folder / "tum", film, "tum")
    make.write_folder(folder / "open3d", film, "open3d")
    make.lens_file(folder / "lens.json", film)
