"""Generation of the benchmark, which can be resumed.

`OUT/bench.json` lists every finished trajectory. It is rewritten after each one, so listed
trajectories are complete and others were never finished.
"""

import json
import logging
import platform
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from clothtrack.errors import InvalidConfigError, InvalidResultError, SimulationDivergedError
from clothtrack.files.atomic_write import atomic_file, storage
from clothtrack.files.many_items import attempts, results_of
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.files.worker_pool import require_workers
from clothtrack.version import __version__
from clothtrack_lab.world.bench import BenchTrajectory, trajectories
from clothtrack_lab.world.episodes import EpisodeConfig, simulate_trajectory

logger = logging.getLogger(__name__)

LIST_FILE = "bench.json"
NAME = "clothtrack-bench"
FORMAT = 1

Entry = dict[str, Any]
"""One trajectory in `bench.json`."""


def generate_bench(
    out: Path,
    selected: Sequence[BenchTrajectory] | None = None,
    *,
    processes: int = 1,
    progress: Progress | None = None,
    ray: str = "",
) -> list[Entry]:
    """Record trajectories of the benchmark into `out/recordings` and `out/truth`.

    A trajectory that is listed in `out/bench.json` is kept. Any other is recorded again and
    overwrites earlier remains. An interrupt keeps finished trajectories.
    """
    require_workers(processes)
    out, selected = Path(out), list(trajectories() if selected is None else selected)
    with locked_output(out):
        listed = _read_list(out)
        for trajectory in selected:
            _refuse_other_settings(out, trajectory, listed.get(trajectory.name))
        recorded = attempts(
            _Filming(out), selected, kind="trajectories", workers=processes, ray=ray,
            progress=progress,
        )  # fmt: skip
        with closing(recorded) as tries:
            for trajectory, entry in results_of(tries):
                if listed.get(trajectory.name) != entry:
                    listed[trajectory.name] = entry
                    _write_list(out, listed)
    return [listed[trajectory.name] for trajectory in selected]


@dataclass(frozen=True)
class _Filming:
    """Recording of trajectories, as `clothtrack.files.many_items.Work`."""

    out: Path

    def name(self, trajectory: BenchTrajectory) -> str:
        """Return the trajectory's own name."""
        return trajectory.name

    def paths(self, trajectory: BenchTrajectory) -> list[Path]:
        """Return truth and recording; the recording is written last."""
        recording, truth = _paths(self.out, trajectory.name)
        return [truth, recording]

    def kept(self, trajectory: BenchTrajectory) -> Entry | None:
        """Return the entry of a trajectory that is listed and there."""
        there = all(path.exists() for path in self.paths(trajectory))
        return _read_list(self.out).get(trajectory.name) if there else None

    def do(self, trajectory: BenchTrajectory) -> Entry:
        """Record it, overwriting the remains of an earlier try."""
        _remove(self.out, trajectory.name)
        return _film(trajectory, self.out)


def table(entries: Sequence[Entry]) -> str:
    """Return one line per trajectory with its seed, measured difficulty and cost."""
    lines = [f"{'trajectory':<24}{'seed':>6}{'frames':>8}{'hidden':>8}{'missing':>9}{'CPU':>8}"]
    for entry in entries:
        shown = entry["measured"]
        lines.append(
            f"{entry['name']:<24}{entry['seed']:>6}{shown['frames']:>8}"
            f"{100.0 * shown['hidden_by_tool_while_carried']:>6.0f} %"
            f"{100.0 * shown['depth_missing']:>7.0f} %{entry['cpu_s']:>6.0f} s"
        )
    return "\n".join(lines)


def _film(trajectory: BenchTrajectory, out: Path) -> Entry:
    """Record one trajectory, with the first of its seeds that does not diverge."""
    start = time.process_time()
    for seed in trajectory.seeds:
        config = trajectory.config(seed)
        try:
            simulate_trajectory(trajectory.kind, seed, out, config=config, name=trajectory.name)
        except SimulationDivergedError as error:
            logger.warning("%s: seed %d left out: %s", trajectory.name, seed, error)
            continue
        return _entry(trajectory, seed, config, out, time.process_time() - start)
    raise SimulationDivergedError(
        f"{trajectory.name}: the physics diverged with each of the seeds {trajectory.seeds[0]} to "
        f"{trajectory.seeds[-1]}; report it with your MuJoCo version ({mujoco.__version__})"
    )


def _entry(
    trajectory: BenchTrajectory, seed: int, config: EpisodeConfig, out: Path, cpu_s: float
) -> Entry:
    _, truth = _paths(out, trajectory.name)
    return {
        "name": trajectory.name,
        "kind": trajectory.kind,
        "split": trajectory.split,
        "hardness": trajectory.hardness,
        "seed": seed,
        "varied": _plain(config),
        "measured": _measured(truth),
        "made_with": f"MuJoCo {mujoco.__version__}, Python {platform.python_version()}, "
        f"{platform.system()} {platform.machine()}",
        "cpu_s": round(cpu_s, 1),
    }


def _measured(truth: Path) -> dict[str, int | float]:
    """Return the measured difficulty of a trajectory, from its truth file."""
    with np.load(truth) as arrays:
        hidden, missing = arrays["hidden_by_tool"], arrays["depth_missing"]
        carried = arrays["gripper_closed"]
        return {
            "frames": len(hidden),
            "hidden_by_tool_while_carried": round(float(hidden[carried].mean()), 3),
            "hidden_by_tool_at_most": round(float(hidden.max()), 3),
            "depth_missing": round(float(missing.mean()), 3),
            "outside_picture_at_most": round(float(arrays["outside_picture"].max()), 3),
            "picks_of_folded_cloth": int(arrays["picked_folded"].sum()),
        }


def _paths(out: Path, name: str) -> tuple[Path, Path]:
    return Path(out) / "recordings" / name, Path(out) / "truth" / f"{name}.npz"


def _remove(out: Path, name: str) -> None:
    """Remove a damaged or unlisted trajectory."""
    recording, truth = _paths(out, name)
    with storage(recording):
        if recording.exists():
            shutil.rmtree(recording)
        truth.unlink(missing_ok=True)


def _refuse_other_settings(
    out: Path, trajectory: BenchTrajectory, entry: Mapping[str, Any] | None
) -> None:
    if entry is None:
        return
    seed = entry["seed"]
    # A setting that was added later had its default value.
    varied = {**_plain(EpisodeConfig()), **entry["varied"]}
    if seed not in trajectory.seeds or varied != _plain(trajectory.config(seed)):
        raise InvalidConfigError(
            f"{out / LIST_FILE}: {trajectory.name} was made with other settings than clothtrack "
            f"{__version__} makes it with (printed, or not?); choose another folder, or remove "
            "this one"
        )


def _plain(config: EpisodeConfig) -> dict[str, Any]:
    """Return a configuration as JSON content."""
    return json.loads(json.dumps(asdict(config)))


def _read_list(out: Path) -> dict[str, Entry]:
    path = Path(out) / LIST_FILE
    if not path.exists():
        return {}
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if (document["name"], document["format"]) != (NAME, FORMAT):
            raise ValueError(f"it is {document['name']}, format {document['format']}")
        return {entry["name"]: entry for entry in document["trajectories"]}
    except KeyError as error:
        raise InvalidResultError(
            f"{path}: not the list of a {NAME}: the field {error} is missing; unpack it again, or "
            "choose another folder"
        ) from error
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InvalidResultError(
            f"{path}: not the list of a {NAME} of format {FORMAT} ({error}); unpack it again, or "
            "choose another folder"
        ) from error


def _write_list(out: Path, listed: Mapping[str, Entry]) -> None:
    """Write the list under a temporary name, then rename it."""
    order = {trajectory.name: number for number, trajectory in enumerate(trajectories())}
    entries = sorted(
        listed.values(),
        key=lambda entry: (order.get(entry["name"], -1), entry["name"]),
    )
    document = {
        "name": NAME,
        "format": FORMAT,
        "clothtrack": __version__,
        "rule": "Tune on dev. Score test and hard; choose nothing by them.",
        "trajectories": entries,
    }
    path = Path(out) / LIST_FILE
    with atomic_file(path) as unfinished:
        unfinished.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
