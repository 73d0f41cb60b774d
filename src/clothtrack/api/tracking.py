"""Track many recordings, or the one shipped with clothtrack."""

import json
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack.api.options import Mode, Ray, Settings, configured_by, require_file
from clothtrack.api.results import Many

if TYPE_CHECKING:
    from clothtrack.evaluation.results import Evaluation
    from clothtrack.evaluation.verdict import Verdict
    from clothtrack.files.progress import Progress
    from clothtrack.tracking.configuration import RunConfig
    from clothtrack.tracking.pipeline import Outcome


@dataclass(frozen=True)
class TrackedRecording:
    """The outcome of tracking one recording.

    Attributes:
        outcome: path of the result, or why there is none.
        verdict: verdict on the result; None without a result.
        frames_after_last_action: first and last of the frames after the last action, which are not
            tracked and keep its final mesh; None if there are none.
    """

    outcome: "Outcome"
    verdict: "Verdict | None"
    frames_after_last_action: tuple[int, int] | None = None

    @classmethod
    def of(cls, outcome: "Outcome") -> "TrackedRecording":
        """Return an outcome with the verdict on its result on disk."""
        from clothtrack.api.run import load

        if outcome.result is None:
            return cls(outcome, None)
        run = load(outcome.result, outcome.recording)
        after = run.frames_after_last_action.tolist()
        return cls(outcome, run.verdict, (after[0], after[-1]) if after else None)

    @property
    def ok(self) -> bool:
        """Whether it was tracked."""
        return self.outcome.result is not None

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why it was not tracked."""
        return () if self.ok else (self.outcome.error,)

    def text(self) -> str:
        """Return the path of the result and its verdict; empty without a result."""
        if self.outcome.result is None or self.verdict is None:
            return ""
        lines = [_line(self.outcome), f"  {self.verdict}"]
        if self.frames_after_last_action:
            first, last = self.frames_after_last_action
            frames = f"frames {first} to {last}" if last > first else f"frame {first}"
            lines.append(
                f"  after the last action, in {frames}, the mesh stays as it ended; a later "
                "last_frame in recording.json tracks on"
            )
        if self.verdict.remedy:
            source = str(self.outcome.recording)
            shown = f"{self.outcome.result} --recordings {source}"
            named = self.verdict.remedy.replace("NAME.zarr", shown).replace("RECORDING", source)
            lines.append(f"  what helps: {named}")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome with its verdict as JSON-compatible values."""
        return {
            **asdict(self.outcome),
            "verdict": self.verdict and self.verdict.as_dict(),
            "frames_after_last_action": self.frames_after_last_action,
        }


@dataclass(frozen=True)
class Demonstration:
    """The result of the demo.

    Attributes:
        outcome: path of the result.
        verdict: verdict on the result.
        evaluation: its measures.
        report: path of its page.
    """

    outcome: "Outcome"
    verdict: "Verdict"
    evaluation: "Evaluation"
    report: Path

    def text(self) -> str:
        """Return the table of measures, and the paths of all results."""
        return (
            f"{self.evaluation}\ntracked  {_line(self.outcome)}\nverdict  {self.verdict}\n"
            f"report   {self.report}   (open it in a browser; it needs no network)"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the same as JSON-compatible values."""
        from clothtrack.evaluation.results import as_plain

        evaluation = as_plain(self.evaluation)
        return {**asdict(self.outcome), "report": self.report, "evaluation": evaluation}


def tracking_config(
    mode: str = "default",
    template: Path | str | None = None,
    weights: Path | str | None = None,
    settings: Sequence[str] = (),
    seed: int = 0,
) -> "RunConfig":
    """Return the configuration that `track_many` uses; the arguments are the same.

    Raises:
        InvalidConfigError: unknown mode or setting, or a file that is missing.
    """
    from clothtrack.api.run import run_config

    files = {"template": template, "weights": weights}
    for name, path in files.items():
        require_file(path, name)
    named = [
        f"initial_state.{name}={json.dumps(str(path))}" for name, path in files.items() if path
    ]
    return run_config(mode, [*named, *settings], seed=seed)


@configured_by(tracking_config)
def track_many(
    recordings: Sequence[Path | str],
    *,
    output: Path | str,
    mode: Mode = "default",
    template: Path | str | None = None,
    weights: Path | str | None = None,
    settings: Settings = (),
    workers: int = 1,
    ray: Ray = "",
    device: str = "cpu",
    seed: int = 0,
    force: bool = False,
    live: bool = False,
    progress: "Progress | None" = None,
    opened: "Callable[[str], None] | None" = None,
) -> Many[TrackedRecording]:
    """Track recordings: the full mesh at every observation (Algorithm 1).

    Each trajectory gets a verdict: trust, look (at it first), or reject; and the expected error.

    Args:
        recordings: recording folders.
        output: folder for one NAME.zarr per recording; existing ones are skipped, so that an
            interrupted run can be resumed. A recording that has changed since is tracked again.
        mode: our default, the paper's method, or its dynamics alone.
        template: the garment's own mesh (`clothtrack garment`), laid on the flat cloth of the first
            frame; by default the recording's template, or a fit.
        weights: weights of the network that makes the first mesh of a recording without a template;
            by default those shipped with clothtrack, and without any a flat garment is fitted.
        settings: changes to the mode, such as search.method=none, or
            initial_state.source=template (network, flat).
        workers: number of processes; each tracks one recording at a time.
        ray: run on Ray: 'local' with WORKERS processes here, or the address of a cluster, such as
            auto or ray://HOST:10001; see docs/cli.md.
        device: where to compute: cpu, or cuda:0.
        seed: stored with the result.
        force: continue although the first mesh lies more than 2 cm (rms) from its cloud.
        live: show the tracking as it proceeds, on a page for this machine only; ends with it.
        progress: called after every frame with a description of the step, the amount of work done,
            and the total.
        opened: called with the address of that page.

    Raises:
        InvalidConfigError: an argument is wrong, or another run writes to `output`.
    """
    from clothtrack.evaluation.verdict import judged
    from clothtrack.geometry.devices import quiet_warp, require_device
    from clothtrack.report.live_tracking import live_tracking
    from clothtrack.tracking.pipeline import track_recordings

    quiet_warp()
    if not ray:
        require_device(device)
    config = tracking_config(mode, template, weights, settings, seed)
    words = [""]

    def told(place: str, done: int, total: int) -> None:
        words[0] = f"{100 * done // total} %   {place}" if total else place
        if progress is not None:
            progress(place, done, total)

    page = live_tracking(lambda: words[0], None, opened=opened) if live else nullcontext()
    with page as shown:
        outcomes = track_recordings(
            [Path(one) for one in recordings], Path(output), config, workers=workers,
            device=device, progress=told, force=force, watch=shown and shown.watch,
            judge=judged, ray=ray,
        )  # fmt: skip
        tracked = Many(tuple(TrackedRecording.of(one) for one in outcomes))
        if shown:
            shown.end("\n".join(filter(None, [tracked.text(), *tracked.doubts])))
    return tracked


def demo(
    *,
    output: Path | str = Path("out/demo"),
    device: str = "cpu",
    progress: "Progress | None" = None,
) -> Demonstration:
    """Track a recording that is shipped with clothtrack, and write its report.

    Args:
        output: folder for the tracked trajectory and the report.
        device: where to compute: cpu, or cuda:0.
        progress: as for `track`.

    Raises:
        InvalidRecordingError: it cannot be tracked.
    """
    from clothtrack.api.look import write_report
    from clothtrack.api.run import evaluate, load
    from clothtrack.errors import InvalidRecordingError
    from clothtrack.recordings.shipped import shipped_recording

    folder = shipped_recording("")
    tracked = track_many([folder], output=output, device=device, progress=progress)
    (outcome,) = (one.outcome for one in tracked)
    if outcome.result is None:
        raise InvalidRecordingError(outcome.error)
    run = load(outcome.result, folder)
    page = write_report(run, Path(output) / f"{run.name}.html")
    return Demonstration(outcome, run.verdict, evaluate(run, device=device), page)


def _line(outcome: "Outcome") -> str:
    """Return the path of a result, and why it was skipped or tracked again."""
    again = "   (recording changed, tracked again)" if outcome.tracked_again else ""
    return f"{outcome.result}" + ("   (finished before)" if outcome.skipped else again)
