"""The verbs of tracking: demo and track."""

import json as json_module
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

import clothtrack as ct
from clothtrack.cli.options import (
    AsJson,
    Device,
    Ray,
    Seed,
    Settings,
    ShowSettings,
    list_settings,
)
from clothtrack.cli.terminal import complain, progress, say, say_result
from clothtrack.errors import InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.evaluation.verdict import Verdict
    from clothtrack.tracking.pipeline import Outcome
    from clothtrack.tracking.protocols import Watch

Mode = Literal["default", "paper", "open_loop"]


def demo(
    *,
    recording: str = "",
    output: Path = Path("out/demo"),
    mode: Mode = "default",
    device: Device = "cpu",
    json: AsJson = False,
) -> int:
    """Track a recording that comes with clothtrack, and write its report.

    Args:
        recording: name of a shipped recording; the first one by default.
        output: folder for the tracked trajectory and the report.
        mode: our default, the paper's method, or its dynamics alone.
        device: where to compute.
        json: machine-readable.
    """
    from clothtrack.evaluation.results import as_plain, summary

    folder = ct.shipped_recording(recording)
    (outcome,) = _track([folder], output, mode, device=device)
    if outcome.result is None:
        complain(outcome.error)
        return 1
    run = ct.load(outcome.result, folder)
    page = ct.write_report(run, output / f"{run.name}.html")
    evaluation = ct.evaluate(run, device=device)
    say_result(
        f"{summary([evaluation])}\ntracked  {_line(outcome)}\nverdict  {run.verdict}\n"
        f"report   {page}   (open it in a browser; it needs no network)",
        {**asdict(outcome), "report": page, "evaluation": as_plain(evaluation)},
        json=json,
    )
    return 0


def track(
    recordings: Positional[tuple[Path, ...]],
    *,
    output: Path | None = None,
    mode: Mode = "default",
    template: Path | None = None,
    weights: Path | None = None,
    settings: Settings = (),
    show_settings: ShowSettings = False,
    workers: int = 1,
    ray: Ray = "",
    device: Device = "cpu",
    seed: Seed = 0,
    force: bool = False,
    live: bool = False,
    port: int | None = None,
    json: AsJson = False,
) -> int:
    """Track recordings: the full mesh at every observation (Algorithm 1).

    A trajectory ends with a word: trust, look (at it first), or reject; and the expected error.

    Args:
        recordings: recording folders.
        output: folder that gets one NAME.zarr per recording; those that are there are skipped,
            so that an interrupted run goes on when it is started again. One whose recording has
            changed since is tracked again.
        mode: our default, the paper's method, or its dynamics alone.
        template: the garment's own mesh (`clothtrack garment`), laid on the flat cloth of the first
            frame; the recording's, or a fit, by default.
        weights: of the network that makes the first mesh of a recording without a template; the
            ones that come with clothtrack by default, and without any a flat garment is fitted.
        settings: changes to the mode, such as search.method=none, or
            initial_state.source=template (network, flat).
        show_settings: list them all with their values and do nothing else.
        workers: processes; each tracks one recording at a time.
        ray: address of Ray, which is to do it.
        device: where to compute.
        seed: stored with the result.
        force: go on although the first mesh lies more than 2 cm (rms) from its cloud.
        live: show the mesh as it grows, on a page for this machine only; ends with the tracking.
        port: of that page; any free one by default.
        json: machine-readable.
    """
    if show_settings:
        from clothtrack.front.run import run_config

        return list_settings(run_config(mode, settings, seed=seed))
    if output is None:
        complain("no place for the results; name a folder with --output")
        return 2
    if not recordings:
        complain("no recording given; name at least one recording folder")
        return 2
    settings = (*_file_settings(template=template, weights=weights), *settings)
    tracked = partial(
        _track, recordings, output, mode, settings,
        seed=seed, device=device, workers=workers, force=force, ray=ray,
    )  # fmt: skip
    outcomes = _track_live(tracked, port) if live else tracked()
    if json:
        rows = [{**asdict(outcome), "verdict": _verdict_fields(outcome)} for outcome in outcomes]
        say(json_module.dumps(rows, indent=2, default=str))
    for outcome in outcomes:
        if outcome.result is None:
            complain(outcome.error)
        elif not json:
            say(_ended(outcome))
    return 1 if any(outcome.result is None for outcome in outcomes) else 0


def _track_live(tracked: "Callable[..., list[Outcome]]", port: int | None) -> "list[Outcome]":
    """Track while a page shows the newest mesh."""
    from clothtrack.report.live_tracking import live_tracking

    def opened(address: str) -> None:
        # Standard output may be one JSON document.
        progress.clear()
        sys.stderr.write(f"{address}   open this to see the mesh grow\n")

    with live_tracking(lambda: progress.text, port, opened=opened) as page:
        outcomes = tracked(watch=page.watch)
        words = [
            outcome.error if outcome.result is None else _ended(outcome) for outcome in outcomes
        ]
        page.end("\n".join(words))
    return outcomes


def _ended(outcome: "Outcome") -> str:
    """Where a result lies, and what it is worth."""
    return f"{_line(outcome)}\n  {_verdict(outcome)}"


def _file_settings(**files: Path | None) -> list[str]:
    """Settings of the first mesh that name a file; refuses a name that is none."""
    named = {name: path for name, path in files.items() if path is not None}
    for name, path in named.items():
        if not path.is_file():
            raise InvalidConfigError(f"{path}: there is no such {name} file; check the name")
    return [f"initial_state.{name}={json_module.dumps(str(path))}" for name, path in named.items()]


def _track(
    recordings: Sequence[Path],
    output: Path,
    mode: Mode,
    settings: Sequence[str] = (),
    *,
    seed: int = 0,
    device: str,
    workers: int = 1,
    force: bool = False,
    watch: "Watch | None" = None,
    ray: str = "",
) -> "list[Outcome]":
    from clothtrack.evaluation.verdict import judged
    from clothtrack.front.run import run_config
    from clothtrack.geometry.devices import require_device
    from clothtrack.tracking.pipeline import track_recordings

    if not ray:
        require_device(device)
    config = run_config(mode, settings, seed=seed)
    return track_recordings(
        recordings, output, config, workers=workers, device=device, progress=progress, force=force,
        watch=watch, judge=judged, ray=ray,
    )  # fmt: skip


def _line(outcome: "Outcome") -> str:
    """Where a result lies, and why it was tracked again or was not."""
    again = "   (recording changed, tracked again)" if outcome.tracked_again else ""
    return f"{outcome.result}" + ("   (finished before)" if outcome.skipped else again)


def _verdict(outcome: "Outcome") -> "Verdict":
    assert outcome.result is not None
    return ct.load(outcome.result, outcome.recording).verdict


def _verdict_fields(outcome: "Outcome") -> dict[str, Any] | None:
    """The verdict as JSON holds it; None where nothing was tracked."""
    if outcome.result is None:
        return None
    return _verdict(outcome).as_dict()
