"""Play a recording as if its camera were live: the verb `live`."""

from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.api.options import Mode, Settings, configured_by
from clothtrack.api.results import Result
from clothtrack.api.tracking import tracking_config
from clothtrack.errors import InvalidConfigError, InvalidRecordingError

if TYPE_CHECKING:
    from clothtrack.live.live_state import LiveState
    from clothtrack.recordings.recording import Recording


@configured_by(tracking_config)
def play_live(
    recording: Path | str,
    *,
    output: Path | str,
    mode: Mode = "default",
    template: Path | str | None = None,
    weights: Path | str | None = None,
    settings: Settings = (),
    device: str = "cpu",
    opened: "Callable[[str], None] | None" = None,
) -> Result:
    """Track a recording at the speed of its clock, as if its camera were live.

    A page on this machine shows the mesh over the observation, its latency, and which part of the
    cloth is lost. Pictures that arrive while an older one is tracked are dropped, except the
    newest. Candidates are not searched. The last lines give the latency and the verdict on the
    result.

    Args:
        recording: a recording folder.
        output: folder for NAME.zarr; an existing one is refused.
        mode: our default, the paper's method, or its dynamics alone.
        template: the garment's own mesh (`clothtrack garment`), laid on the flat cloth of the first
            picture; by default the recording's template, or a fit.
        weights: weights of the network that makes the first mesh of a recording without a template.
        settings: changes to the mode, such as color=false.
        device: where to compute: cpu, or cuda:0.
        opened: called with the address of the page; without it there is no page.

    Raises:
        InvalidConfigError: an argument is wrong, or the result exists already.
        InvalidRecordingError: the recording cannot be used, or the first mesh is not on its cloud.
        StorageError: the disk refuses.
    """
    from clothtrack.api.live import LiveTracker
    from clothtrack.live.live_stream import LiveStream
    from clothtrack.live.playback import Latencies, play
    from clothtrack.recordings.store import read_recording
    from clothtrack.report.live_tracking import live_tracking

    source = read_recording(Path(recording))
    path = Path(output) / f"{source.name}.zarr"
    if path.exists():
        raise InvalidConfigError(f"{path} is there already; remove it, or name another --output")
    camera = source.cameras[0]
    if len(source.cameras) > 1 or camera.name not in source.frames[0].depth:
        raise InvalidRecordingError(
            f"{source.folder}: {len(source.cameras)} cameras, with depth in the first frame: "
            f"{', '.join(source.frames[0].depth) or 'none'}; what is tracked live has one camera, "
            "with depth: use clothtrack track"
        )
    latencies, words = Latencies(), ["loading"]

    def served(state: "LiveState") -> None:
        latencies.add(state)
        stalled = f"; nothing from {' and '.join(state.stalled)}" if state.stalled else ""
        said = "".join(f"; {note}" for note in state.notes)
        words[0] = (
            f"at {state.time_s:.1f} s: latency {latencies.text()}{_lost(state, source)}{stalled}"
            f"{said}"
        )

    config = tracking_config(mode, template, weights, settings)
    page = live_tracking(lambda: words[0], None, opened=opened) if opened else nullcontext()
    with page as shown:
        tracker = LiveTracker(
            source.cloth, camera, table=source.table, config=config, device=device,
            watch=None if shown is None else shown.watch, name=source.name,
        )  # fmt: skip
        with LiveStream(tracker, served) as stream:
            play(source, stream)
        words[0] = f"all pictures are served, latency {latencies.text()}"
        run = tracker.close(source)
        run.save(path)
        text = f"latency  {latencies.text()}\ntracked  {path}\nverdict  {run.verdict}"
        if shown:
            shown.end(text)
    report = {"result": path, "latency": latencies.as_dict(), "verdict": run.verdict.as_dict()}
    return Result(text, report)


def _lost(state: "LiveState", recording: "Recording") -> str:
    """Return in words which part of the cloth is away from the observation."""
    from clothtrack.evaluation.places import place_of

    if not state.lost.any():
        return ""
    place = place_of(state.positions.astype(float), state.lost, recording.cameras)
    return f"; lost: the cloth {place}, {100 * state.lost.mean():.0f} % of it"
