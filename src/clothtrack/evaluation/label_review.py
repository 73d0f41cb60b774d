"""A person's decisions about labels: accepted, rejected, or still open.

The decisions are stored in NAME.review.json beside NAME.zarr, so that the tracked trajectory stays
unchanged. Each decision includes a hash of the reviewed mesh: after tracking again, old decisions
are refused instead of being applied to the new meshes.
"""

import hashlib
import json
import logging
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_evidence import labels_of
from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.files.atomic_write import atomic_file
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

FORMAT = "clothtrack-label-review"
FORMAT_VERSION = 1
REVIEW_SUFFIX = ".review.json"

Verdict = Literal["accepted", "rejected", "open"]


@dataclass(frozen=True)
class ReviewedLabel:
    """A label and the decision about it.

    Attributes:
        mesh: first 16 hexadecimal digits of the SHA-256 of its vertices (float32, little endian).
    """

    action: int
    frame: int
    mesh: str
    verdict: Verdict = "open"


@dataclass(frozen=True)
class LabelReview:
    """The decisions about one tracked trajectory."""

    name: str
    labels: tuple[ReviewedLabel, ...]

    @classmethod
    def blank(cls, tracked: TrackedTrajectory) -> "LabelReview":
        """Return a review in which all labels are open."""
        labels = (
            ReviewedLabel(number, int(label.frame), _digest(label.vertices))
            for number, label in enumerate(labels_of(tracked))
        )
        return cls(tracked.name, tuple(labels))

    @property
    def rejected(self) -> frozenset[int]:
        """Numbers of the actions whose label was rejected."""
        return frozenset(label.action for label in self.labels if label.verdict == "rejected")

    def decided(self, action: int, verdict: Verdict) -> "LabelReview":
        """Return a copy of the review with a new decision about an action."""
        labels = tuple(
            replace(label, verdict=verdict) if label.action == action else label
            for label in self.labels
        )
        return replace(self, labels=labels)

    def as_document(self) -> dict[str, Any]:
        """Return the content of the file."""
        return {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "trajectory": self.name,
            "labels": [vars(label) for label in self.labels],
        }

    def save(self, path: Path) -> None:
        """Write the review as JSON, whole or not at all."""
        with atomic_file(path) as temporary:
            text = json.dumps(self.as_document(), indent=2)
            temporary.write_text(text + "\n", encoding="utf-8")


def review_path(tracked: Path) -> Path:
    """Return the path of a trajectory's review, NAME.review.json beside NAME.zarr."""
    return tracked.with_name(tracked.name.removesuffix(".zarr") + REVIEW_SUFFIX)


def read_review(path: Path, tracked: TrackedTrajectory) -> LabelReview:
    """Return the review at `path`, or a blank one if there is no such file."""
    blank = LabelReview.blank(tracked)
    if not path.exists():
        return blank
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        stored = document["format"], document["version"]
        if stored != (FORMAT, FORMAT_VERSION):
            raise ValueError(f"format and version are {stored}")
        verdicts = {_key(label): label["verdict"] for label in document["labels"]}
        for verdict in verdicts.values():
            if verdict not in get_args(Verdict):
                raise ValueError(f"a verdict is {verdict!r}")
        name = document["trajectory"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InvalidResultError(
            f"{path}: not a review of version {FORMAT_VERSION} ({error}); remove it, and review "
            f"the labels again with: clothtrack view {tracked.name}.zarr"
        ) from error
    expected = [_key(vars(label)) for label in blank.labels]
    if name != tracked.name or list(verdicts) != expected:
        raise InvalidResultError(
            f"{path}: reviews other meshes than {tracked.name} has now (it was tracked again "
            "since, or the file belongs elsewhere); remove it, and review the labels again"
        )
    labels = zip(blank.labels, verdicts.values(), strict=True)
    return replace(blank, labels=tuple(replace(label, verdict=text) for label, text in labels))


def _key(label: Mapping[str, Any]) -> tuple[int, int, str]:
    """Return the key that identifies a reviewed label."""
    return label["action"], label["frame"], label["mesh"]


def _digest(vertices: np.ndarray) -> str:
    return hashlib.sha256(np.ascontiguousarray(vertices, "<f4").tobytes()).hexdigest()[:16]


logger = logging.getLogger(__name__)


def pseudo_labels_of(
    tracked: TrackedTrajectory, judged: Sequence[LabelQuality], rejected: Collection[int]
) -> "list[PseudoLabel]":
    """Return the first frame and the end of every action that has a quality and is not rejected."""
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

    chosen = [PseudoLabel(int(tracked.frames[0]), tracked.positions[0])]
    for action, quality in zip(tracked.actions, judged, strict=True):
        if quality.action in rejected:
            continue
        if math.isnan(quality.expected_error_mm):
            logger.warning(
                "%s: frame %d has no label: nothing was seen to judge it by",
                tracked.name,
                quality.frame,
            )
            continue
        chosen.append(PseudoLabel(quality.frame, action.positions_after_final_alignment))
    return chosen
