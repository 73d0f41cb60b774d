"""The command line: one verb per stage, in the order of the method.

Every verb parses, loads, calls one function and saves. The stages are imported when their verb is
called, so that `--help` is instant. Exit codes: 0 done, 1 bad input, a full disk or an interrupt
(one clear line on standard error), 2 wrong usage.
"""

import json as json_module
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, Positional, arg

from clothtrack.cli.act import ACTING_VERBS
from clothtrack.cli.capture import SETTING_UP_VERBS
from clothtrack.cli.importing import ACQUISITION_VERBS
from clothtrack.cli.learn import LEARNING_VERBS
from clothtrack.cli.look import LOOKING_VERBS
from clothtrack.cli.options import AsJson, Device, Seed, Settings
from clothtrack.cli.terminal import complain, exit_code, progress, say
from clothtrack.errors import InvalidConfigError
from clothtrack.tracking.artefacts import inside, load_tracked, recording_of

if TYPE_CHECKING:
    from clothtrack.tracking.pipeline import Outcome, RunConfig

Mode = Literal[
    "default",
    "full_held_paper",
    "open_loop",
    "no_pseudo_action",
    "no_dynamics_initialisation",
    "no_action_conditioning",
    "no_final_alignment",
]
VERBS: list[Callable[..., int]] = []


def _verb(function: Callable[..., int]) -> Callable[..., int]:
    """List a verb; Warp greets on standard output, where our results go, unless it is told."""

    @wraps(function)
    def quietly(*arguments: Any, **options: Any) -> int:
        from clothtrack.geometry.devices import quiet_warp

        quiet_warp()
        return function(*arguments, **options)

    VERBS.append(quietly)
    return quietly


@_verb
def demo(
    *,
    recording: str = "",
    output: Path = Path("out/demo"),
    mode: Mode = "default",
    device: Device = "cpu",
) -> int:
    """Track a recording that comes with clothtrack, and write its report.

    Args:
        recording: name of a shipped recording; the first one by default.
        output: folder for the tracked trajectory and the report.
        mode: the tracker's default, the paper's method, or an ablation of it.
        device: where to compute.
    """
    from clothtrack.evaluation.results import evaluate as measure
    from clothtrack.evaluation.results import table
    from clothtrack.recordings.shipped import shipped_recording
    from clothtrack.recordings.store import read_recording
    from clothtrack.report.page import write_report
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

    folder = shipped_recording(recording)
    config = _run_config(mode, (), seed=0)
    outcome = _track([folder], output, config, device=device)[0]
    if outcome.result is None:
        complain(outcome.error)
        return 1
    tracked, source = TrackedTrajectory.load(outcome.result), read_recording(folder)
    page = write_report(tracked, source, output / f"{tracked.name}.html")
    say(table([measure(tracked, source, device=device)]))
    say(f"tracked  {_told(outcome)}")
    say(f"report   {page}   (open it in a browser; it needs no network)")
    return 0


@_verb
def inspect(recording: Positional[Path], *, json: AsJson = False) -> int:
    """Is this recording readable? What is in it, what is wrong with it?

    Args:
        recording: folder with a recording.json.
        json: machine-readable.
    """
    from clothtrack.recordings.inspection import inspect as inspect_recording

    found = inspect_recording(recording)
    say(json_module.dumps(found.as_dict(), indent=2) if json else found.text())
    return 0 if found.valid else 1


for _brings_in in (*ACQUISITION_VERBS, *SETTING_UP_VERBS):
    _verb(_brings_in)


@_verb
def simulate(
    output: Positional[Path],
    *,
    garment: Annotated[Literal["towel", "tshirt"], arg(aliases=["--kind"])] = "towel",
    states: int | None = None,
    trajectories: int | None = None,
    actions: int | None = None,
    settings: Settings = (),
    workers: int = 1,
    seed: Seed = 0,
) -> int:
    """Film a stand-in world; or, with --states, crumple garments for a network to learn from.

    Args:
        output: folder for recordings/ and truth/, or shards/; what is finished there is kept.
        garment: what lies on the table.
        states: film nothing; make at least so many labelled states with our own solver.
        trajectories: how many recordings, 1 by default; they get the seeds SEED, SEED + 1, ...
        actions: pick-and-places per recording, 3 by default.
        settings: changes to what is filmed, such as sensor.width=320 or vertex_count=300.
        workers: processes.
        seed: of garment, pose, actions, camera and noise.
    """
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.data.states import StatesConfig, generate_states
    from clothtrack.world import episodes

    if states is not None:
        if trajectories is not None or actions is not None:
            complain(
                "--states films nothing, so that --trajectories and --actions mean nothing; leave "
                "them out, or --states"
            )
            return 2
        recipe = with_settings(StatesConfig(), settings)
        made = generate_states(
            output, garment, states, seed=seed, config=recipe, processes=workers, progress=progress
        )
        say(f"{made.folder / 'README.md'}   ({len(made.shards)} garments)")
        return 0
    wanted = 1 if trajectories is None else trajectories
    told = {} if actions is None else {"actions": actions}
    config = with_settings(episodes.EpisodeConfig(**told), settings)
    folders = episodes.simulate(
        output, garment, wanted, seed=seed, config=config, processes=workers
    )
    say("\n".join(map(str, folders)))
    return 0 if len(folders) == wanted else 1


@_verb
def bench(
    output: Positional[Path],
    *,
    split: Literal["all", "dev", "test", "hard"] = "all",
    verify: bool = False,
    workers: int = 1,
    json: AsJson = False,
) -> int:
    """Film the benchmark: 20 trajectories to tune on (dev), 30 to score (test), 10 hard ones.

    Args:
        output: folder for recordings/, truth/ and their list; finished trajectories are kept.
        split: only this part.
        verify: film nothing; check what is there against its checksums.
        workers: processes.
        json: machine-readable.
    """
    from clothtrack.world import bench as contents
    from clothtrack.world import bench_generation as generation

    wanted = contents.trajectories(contents.SPLITS if split == "all" else (split,))
    if verify:
        for line in (wrong := generation.verify_bench(output, wanted)):
            complain(line)
        told = f"{len(wanted) - len(wrong)} of {len(wanted)} trajectories are as listed"
        say(json_module.dumps({"trajectories": len(wanted), "wrong": wrong}) if json else told)
        return 1 if wrong else 0
    entries = generation.generate_bench(output, wanted, processes=workers, progress=progress)
    say(json_module.dumps(entries, indent=2) if json else generation.table(entries))
    return 0


@_verb
def track(
    recordings: Positional[tuple[Path, ...]],
    *,
    output: Path,
    mode: Mode = "default",
    weights: Path | None = None,
    settings: Settings = (),
    workers: int = 1,
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Track recordings: the full mesh at every observation (Algorithm 1).

    Args:
        recordings: recording folders.
        output: folder that gets one NAME.zarr per recording; those that are there are skipped,
            so that an interrupted run goes on when it is started again. One whose recording has
            changed since is tracked again.
        mode: the tracker's default, the paper's method, or an ablation of it.
        weights: of the network that makes the first mesh of a recording without a template; the
            ones that come with clothtrack by default, and without any a flat garment is fitted.
        settings: changes to the mode, or first_mesh.source=template, network or flat.
        workers: processes; each tracks one recording at a time.
        device: where to compute.
        seed: stored with the result.
        json: machine-readable.
    """
    if not recordings:
        complain("no recording given; name at least one recording folder")
        return 2
    if weights is not None:
        if not weights.is_file():
            raise InvalidConfigError(f"{weights}: there is no such weights file; check the name")
        settings = (f"first_mesh.weights={json_module.dumps(str(weights))}", *settings)
    outcomes = _track(
        recordings, output, _run_config(mode, settings, seed=seed), device=device, workers=workers
    )
    if json:
        say(json_module.dumps([asdict(one) for one in outcomes], indent=2, default=str))
    for one in outcomes:
        if one.result is None:
            complain(one.error)
        elif not json:
            say(_told(one))
    return 1 if any(one.result is None for one in outcomes) else 0


@_verb
def evaluate(
    tracked: Positional[tuple[Path, ...]],
    *,
    recordings: Path,
    truth: Path | None = None,
    output: Path | None = None,
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Measure tracked trajectories, judge their labels, and compare with the truth if it is known.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        recordings: the recording, or the folder in which recordings lie by name.
        truth: truth file, or the folder in which NAME.npz lie.
        output: also write the rows to this JSON file.
        device: where to compute.
        seed: of surface samples.
        json: machine-readable.
    """
    from clothtrack.evaluation.results import as_json, save_json, table
    from clothtrack.evaluation.results import evaluate as measure
    from clothtrack.evaluation.truth import Truth
    from clothtrack.geometry.devices import require_device

    if not tracked:
        complain("no tracked trajectory given; name at least one NAME.zarr folder")
        return 2
    require_device(device)
    evaluations = []
    for path in tracked:
        result = load_tracked(path)
        known = None if truth is None else Truth.load(inside(truth, f"{result.name}.npz"))
        recording = recording_of(result, recordings, path)
        evaluations.append(measure(result, recording, known, device=device, seed=seed))
    if output is not None:
        save_json(evaluations, output)
    say(as_json(evaluations) if json else table(evaluations))
    return 0


for _elsewhere in (*LOOKING_VERBS, *LEARNING_VERBS, *ACTING_VERBS):
    _verb(_elsewhere)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        arguments: the words after `clothtrack`; those of the process by default.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    level = logging.INFO if "--verbose" in words else logging.WARNING
    words = [word for word in words if word != "--verbose"]
    logging.basicConfig(level=level, stream=sys.stderr, format="%(levelname)s %(message)s")
    return exit_code(
        lambda: tyro.extras.subcommand_cli_from_dict(
            {function.__name__.replace("_", "-"): function for function in VERBS},
            prog="clothtrack",
            description=(
                "Know where every point of a crumpled cloth is, from one depth camera. "
                "Any verb takes --verbose."
            ),
            args=words,
            config=(FlagCreatePairsOff, OmitArgPrefixes),
        )
    )


def _run_config(mode: str, settings: Sequence[str], *, seed: int) -> "RunConfig":
    from clothtrack.files.settings import with_settings
    from clothtrack.tracking.configuration import mode as tracker_mode
    from clothtrack.tracking.pipeline import RunConfig

    return with_settings(RunConfig(tracker=tracker_mode(mode), seed=seed), settings)


def _track(
    recordings: Sequence[Path],
    output: Path,
    config: "RunConfig",
    *,
    device: str,
    workers: int = 1,
) -> "list[Outcome]":
    from clothtrack.geometry.devices import require_device
    from clothtrack.tracking.pipeline import track_recordings

    require_device(device)
    return track_recordings(
        recordings, output, config, workers=workers, device=device, progress=progress
    )


def _told(outcome: "Outcome") -> str:
    """Where a result lies, and why it was tracked again or was not."""
    again = "   (recording changed, tracked again)" if outcome.tracked_again else ""
    return f"{outcome.result}" + ("   (finished before)" if outcome.skipped else again)
