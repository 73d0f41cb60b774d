"""Label and evaluate many tracked trajectories, in several processes or with Ray."""

import json
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack._shown import short_repr
from clothtrack.api.options import Garment, Ray
from clothtrack.api.results import Many
from clothtrack.errors import InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.evaluation.results import Evaluation
    from clothtrack.files.progress import Progress


@dataclass(frozen=True)
class Evaluations:
    """The measures of many trajectories.

    Attributes:
        each: measures of each trajectory, in order.
        all_measures: whether the text has every measure, in wide rows.
    """

    each: "tuple[Evaluation, ...]"
    all_measures: bool = False

    __repr__ = short_repr

    def text(self) -> str:
        """Return the measures as a table."""
        from clothtrack.evaluation.results import summary, table

        return (table if self.all_measures else summary)(self.each)

    def as_dict(self) -> list[dict[str, Any]]:
        """Return the measures as JSON-compatible values."""
        from clothtrack.evaluation.results import as_plain

        return [as_plain(one) for one in self.each]


@dataclass(frozen=True)
class LabelFile:
    """The labels of one trajectory.

    Attributes:
        labels: the file.
        frames: frames of the recording that have a label.
        rejected: number of labels left out after a review.
    """

    labels: Path
    frames: tuple[int, ...]
    rejected: int

    __repr__ = short_repr

    def text(self) -> str:
        """Return one line."""
        left_out = f"; {self.rejected} rejected in review left out" if self.rejected else ""
        return f"{self.labels}   {len(self.frames)} labels{left_out}"

    def as_dict(self) -> dict[str, Any]:
        """Return the same as JSON-compatible values."""
        return {**asdict(self), "labels": str(self.labels)}


def label_many(
    tracked: Sequence[Path | str],
    *,
    output: Path | str,
    recordings: Path | str | None = None,
    garment: Garment | None = None,
    workers: int = 1,
    ray: Ray = "",
    device: str = "cpu",
    progress: "Progress | None" = None,
) -> Many[LabelFile]:
    """Make pseudo-labels of tracked trajectories: the data set that `finetune` learns from.

    Labels that a person rejected (`clothtrack view`, NAME.review.json) are left out.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        output: folder for one NAME.labels.npz per trajectory; existing files made from the same
            trajectory, review and options are kept.
        recordings: the recording, or the folder that contains recordings by name; by default it is
            searched beside NAME.zarr and in recordings/ beside its folder.
        garment: kind of garment, if the recording does not give it or gives another.
        workers: number of processes.
        ray: address of Ray, to run the work there; 'local' for this machine.
        device: where to compute: cpu, or cuda:0.
        progress: called first, and after each trajectory.

    Raises:
        InvalidConfigError: two trajectories have one name, or another run writes to `output`.
        ClothTrackError: a trajectory cannot be labeled (raised after all others), or a worker died.
    """
    from clothtrack.api.learning import require_learning

    require_learning()
    from clothtrack.api.work import Labeling, Source
    from clothtrack.files.many_items import attempts, results_of
    from clothtrack.files.output_lock import locked_output
    from clothtrack.reconstruction.data.pseudo_labels import read_labels

    paths = _without_twins(tracked)
    options = {"garment": garment, "device": device}
    work = Labeling(Source(recordings and Path(recordings), paths, options), Path(output))
    labeled = attempts(
        work, paths, kind="trajectories", workers=workers, ray=ray, device=device,
        progress=progress,
    )  # fmt: skip
    with locked_output(Path(output)), closing(labeled) as tries:
        files = dict(results_of(tries))
    found = []
    for file in (files[path] for path in paths):
        labels = read_labels(file)
        rejected = len(labels.provenance["rejected_actions"])
        found.append(LabelFile(file, tuple(labels.frames), rejected))
    return Many(tuple(found))


def evaluate_many(
    tracked: Sequence[Path | str],
    *,
    recordings: Path | str | None = None,
    truth: Path | str | None = None,
    output: Path | str | None = None,
    all: bool = False,  # noqa: A002
    workers: int = 1,
    ray: Ray = "",
    device: str = "cpu",
    seed: int = 0,
    progress: "Progress | None" = None,
) -> Evaluations:
    """Measure tracked trajectories, judge their labels, and compare with the truth if it is known.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        recordings: the recording, or the folder that contains recordings by name; by default it is
            searched beside NAME.zarr and in recordings/ beside its folder.
        truth: truth file, or the folder that contains NAME.npz.
        output: also write all measures to this JSON file. Beside it, a hidden folder keeps those of
            each trajectory, so that an interrupted run can resume.
        all: show every measure, before and after the final alignment, in wide rows.
        workers: number of processes.
        ray: address of Ray, to run the work there; 'local' for this machine.
        device: where to compute: cpu, or cuda:0.
        seed: random seed of surface samples.
        progress: called first, and after each trajectory.

    Raises:
        InvalidConfigError: another run writes to `output`.
        ClothTrackError: one cannot be measured (raised after all others), or a worker died.
    """
    from clothtrack.api.work import Measuring, Source
    from clothtrack.evaluation.results import as_plain
    from clothtrack.files.atomic_write import write_file
    from clothtrack.files.many_items import attempts, results_of
    from clothtrack.files.output_lock import locked_output

    paths = tuple(Path(one) for one in tracked)
    options = {"truth": truth, "device": device, "seed": seed}
    file = None if output is None else Path(output)
    folder = None if file is None else file.with_name(f".{file.name}.measured")
    measuring = attempts(
        Measuring(Source(recordings and Path(recordings), paths, options), folder), paths,
        kind="trajectories", workers=workers, ray=ray, device=device, progress=progress,
    )  # fmt: skip
    with nullcontext() if folder is None else locked_output(folder), closing(measuring) as tries:
        measured = dict(results_of(tries))
        found = [measured[path] for path in paths]
        if file is not None:
            rows = [as_plain(one) for one in found]
            write_file(file, (json.dumps(rows, indent=2, allow_nan=False) + "\n").encode())
    return Evaluations(tuple(found), all)


def _without_twins(tracked: Sequence[Path | str]) -> tuple[Path, ...]:
    paths = tuple(Path(one) for one in tracked)
    names = [path.stem for path in paths]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InvalidConfigError(
            f"two trajectories are called {min(twice)!r}, their labels would overwrite each "
            "other; give each a folder of its own with --output"
        )
    return paths
