"""The verb that measures what was tracked: evaluate."""

from pathlib import Path

from tyro.conf import Positional

from clothtrack.cli.options import AsJson, Device, Seed
from clothtrack.cli.terminal import complain, say
from clothtrack.tracking.artefacts import inside, load_tracked, recording_of


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
