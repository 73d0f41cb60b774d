"""What a round of `improve` learns from: its episodes tracked, labelled, and weighed."""

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_quality import judge_labels
from clothtrack.evaluation.label_worth import (
    LabelWorth,
    Teaches,
    network_error_mm,
    with_first_mesh,
)
from clothtrack.files.atomic_write import write_file
from clothtrack.files.progress import Progress
from clothtrack.recordings.reversal import reversed_recording
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.template_file import read_template
from clothtrack.tracking.artefacts import load_tracked
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.pipeline import Outcome, track_recordings

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.pseudo_labels import LabelledRecording

logger = logging.getLogger(__name__)

EXPECTED = "expected_error_mm"
"""Where the provenance of labels has the expected error of each [mm], by frame."""


@dataclass(frozen=True)
class EpisodeLabels:
    """The labels of one episode.

    Attributes:
        path: their file.
        recording: folder of the recording that they belong to, backwards where it was tracked so.
    """

    path: Path
    recording: Path


def label_episodes(
    folder: Path,
    kind: str,
    weights: Path,
    track: RunConfig,
    *,
    template: str = "",
    hindsight: bool = True,
    device: str = "cpu",
    progress: Progress | None = None,
) -> list[EpisodeLabels]:
    """Track the episodes of a round and label them; what cannot be tracked has no label.

    Args:
        folder: of the round.
        kind: the garment.
        weights: of the network that the first meshes come from.
        track: how recordings are tracked.
        template: file of the garment's own mesh; empty: a usual cut in the recording's size.
        hindsight: track them from their end to their beginning.
        device: where to compute.
        progress: called while it is tracked.
    """
    recordings = sorted((folder / "flattening" / "recordings").glob("[!.]*"))
    if hindsight:
        # Apart from what was tracked forwards: names of recordings, and of frames, are the same.
        folder = folder / "hindsight"
        recordings = [
            reversed_recording(read_recording(one), folder / "recordings" / one.name).folder
            for one in recordings
        ]
    first = replace(track.initial_state, source="network", weights=str(weights), template=template)
    outcomes = track_recordings(
        recordings, folder / "tracked", replace(track, initial_state=first), device=device,
        progress=progress,
    )  # fmt: skip
    written = []
    for outcome in outcomes:
        path = folder / "labels" / f"{outcome.recording.name}.labels.npz"
        if outcome.result is None:
            logger.warning("no label: %s", outcome.error)
        elif (path.exists() and not outcome.tracked_again) or _labelled(
            outcome, path, kind, device=device
        ):
            written.append(EpisodeLabels(path, outcome.recording))
    return written


def _labelled(outcome: Outcome, path: Path, kind: str, *, device: str) -> bool:
    """Write the labels of one tracked episode; whether there are any."""
    from clothtrack.evaluation.label_selection import pseudo_labels_of
    from clothtrack.reconstruction.data.pseudo_labels import label_recording, write_labels

    tracked = load_tracked(outcome.result)
    recording = read_recording(outcome.recording)
    judged = judge_labels(tracked, recording, device=device)
    try:
        chosen = pseudo_labels_of(tracked, judged, (), flat_start=False)
    except InvalidResultError as error:
        # An episode in which nothing promised a gain has no action, and so no label.
        logger.warning("no label: %s", error)
        return False
    origin = tracked.provenance.get("initial_state", {})
    expected = {one.frame: with_first_mesh(one.expected_error_mm, origin) for one in judged}
    provenance = {
        "tracked": dict(tracked.provenance),
        EXPECTED: {str(label.frame): expected[label.frame] for label in chosen},
    }
    labelled = label_recording(recording, tracked.mesh, chosen, kind=kind, provenance=provenance)
    write_labels(labelled, path)
    return True


def worth_of(
    labels: Sequence[EpisodeLabels],
    weights: Path,
    kind: str,
    teaches: Teaches,
    *,
    template: str = "",
    device: str = "cpu",
) -> list[LabelWorth]:
    """Return every label beside the network that is to learn from it.

    Args:
        labels: of all rounds so far.
        weights: of the network as it is now.
        kind: the garment.
        teaches: decides.
        template: file of the garment's own mesh; empty: none.
        device: where to compute.
    """
    from clothtrack.reconstruction.data.pseudo_labels import read_labels
    from clothtrack.reconstruction.model_loading import load_model

    model = load_model(kind, weights, device=device)
    mesh = read_template(Path(template)) if template else None
    found = []
    for one in labels:
        labelled = read_labels(one.path)
        for frame in labelled.frames:
            label_mm = float(labelled.provenance[EXPECTED][str(frame)])
            network_mm = network_error_mm(
                model, one.recording, frame, kind=kind, template=mesh, device=device
            )
            used = teaches(label_mm, network_mm)
            found.append(LabelWorth(labelled.name, frame, label_mm, network_mm, used))
    return found


def taught(
    labels: Sequence[EpisodeLabels], worth: Sequence[LabelWorth]
) -> "list[LabelledRecording]":
    """Return the labels that are learned from; recordings without one are left out.

    Args:
        labels: of all rounds so far.
        worth: of each label, in the order of `worth_of`.
    """
    from clothtrack.reconstruction.data.pseudo_labels import read_labels

    left = list(worth)
    chosen = []
    for one in labels:
        labelled = read_labels(one.path)
        own, left = left[: len(labelled.frames)], left[len(labelled.frames) :]
        kept = [number for number, label in enumerate(own) if label.used]
        if kept:
            frames = tuple(labelled.frames[number] for number in kept)
            pictures = tuple(labelled.pictures[number] for number in kept)
            chosen.append(replace(labelled, frames=frames, pictures=pictures))
    return chosen


def write_worth(path: Path, worth: Sequence[LabelWorth]) -> None:
    """Write what was learned from and what was not, with both expected errors.

    Raises:
        StorageError: the disk refuses.
    """
    write_file(path, json.dumps([asdict(one) for one in worth], indent=1).encode())


def read_worth(path: Path) -> list[LabelWorth]:
    """Read what `write_worth` has written.

    Raises:
        InvalidResultError: it is damaged.
    """
    try:
        return [LabelWorth(**one) for one in json.loads(path.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InvalidResultError(
            f"{path}: not what was learned from ({error}); remove it, and run the command again"
        ) from error
