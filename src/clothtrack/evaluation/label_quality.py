"""Expected error of a label, estimated without the truth.

The logarithm of the error is a weighted sum of logarithms of the evidence. The weights are never
negative, so that worse evidence can only increase the expected error. The weights come with the
package; `python experiments label_quality` fits them on the benchmark's `dev` split.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_evidence import (
    EVIDENCE_NAMES,
    LabelEvidence,
    label_evidence,
    labels_of,
    misfit_at,
)
from clothtrack.evaluation.local_misfit import LocalMisfit
from clothtrack.evaluation.places import place_of
from clothtrack.files.atomic_write import atomic_file
from clothtrack.files.bounds import Bounds, Checked
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.tracked_trajectory import TrackedAction, TrackedTrajectory

FORMAT = "clothtrack-label-quality"
FORMAT_VERSION = 1
SHIPPED = Path(__file__).with_name("label_quality.json")

SCALES: Mapping[str, float] = {
    "silhouette_gap": 0.005,
    "cloud_gap_m": 5e-4,
    "mesh_gap_m": 5e-4,
    "edge_strain_p95": 0.005,
    "crossing_rate": 1.0,
    "final_shift_m": 5e-4,
    "travelled_m": 0.01,
    "share_hidden": 0.05,
    "action": 1.0,
}
"""Scale of each piece of evidence: it counts linearly below and logarithmically above.

In the evidence's own units; roughly the effect of sensor noise, not fitted.
"""

SHRINKAGE = 0.1
"""Weight of the squared coefficients against the mean squared residual.

Correlated pieces of evidence share the weight. Not fitted, because from 0.02 to 0.3 the
cross-validated rank correlation changes by 0.01.
"""


@dataclass(frozen=True)
class QualityModel(Checked):
    """Model of the expected error as a function of the evidence.

    ln(error / 1 m) = log_error + sum of weights * ln(1 + evidence / scale), weights >= 0.

    Attributes:
        log_error: logarithm of the error [m] of a label without evidence against it.
        weights: weights by name of the evidence, 0 or more; 0 for a missing name.
        provenance: labels and commit of the fit, and the accuracy on other labels.
    """

    log_error: Annotated[float, Bounds()]
    weights: Mapping[str, float]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the model is valid and monotone."""
        super().__post_init__()
        unknown = set(self.weights) - set(EVIDENCE_NAMES)
        if unknown:
            raise InvalidConfigError(
                f"weights has {min(unknown)!r}; known evidence: {', '.join(EVIDENCE_NAMES)}"
            )
        for name, weight in self.weights.items():
            if not (math.isfinite(weight) and weight >= 0):
                raise InvalidConfigError(f"weights.{name} is {weight}; it must be 0 or more")

    def expected_error_m(self, evidence: LabelEvidence) -> float:
        """Return the expected mean vertex error [m]; NaN if evidence with a weight is missing."""
        terms = _terms(evidence)
        parts = [w * terms[EVIDENCE_NAMES.index(n)] for n, w in self.weights.items() if w > 0]
        return math.exp(self.log_error + sum(parts))

    def save(self, path: Path) -> None:
        """Write the model as JSON, whole or not at all."""
        document = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "log_error": self.log_error,
            "weights": dict(self.weights),
            "provenance": dict(self.provenance),
        }
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path = SHIPPED) -> "QualityModel":
        """Read a model that `save` wrote; by default the shipped one."""
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            stored = document["format"], document["version"]
            if stored == (FORMAT, FORMAT_VERSION):
                keys = ("log_error", "weights", "provenance")
                return cls(**{key: document[key] for key in keys})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InvalidResultError(
                f"{path} is not a label quality model ({error}); "
                "python experiments label_quality --fit writes one"
            ) from error
        raise InvalidResultError(
            f"{path}: format and version are {stored}, expected {(FORMAT, FORMAT_VERSION)}; "
            "fit it again with python experiments label_quality --fit"
        )


FAR_M = 0.015
"""Misfit of a patch of cloth (`local_misfit`) [m] above which it is misplaced."""

_FEWEST_FRAMES_AFTER = 3
"""Least number of frames after an action; released cloth settles for a frame or two."""


@dataclass(frozen=True)
class Misplaced:
    """The part of the mesh that contradicts the observation.

    Attributes:
        share: share of the vertices, 0 to 1.
        far_m: 90th percentile of their misfit [m]; 0 if there is none.
        place: place in the picture, such as "at the left".
    """

    share: float = 0.0
    far_m: float = 0.0
    place: str = ""

    @property
    def text(self) -> str:
        """Description of the part."""
        if not self.share:
            return f"no part of the cloth is more than {1e3 * FAR_M:.0f} mm from what was seen"
        part = f"the cloth {self.place}, {100 * self.share:.0f} % of it"
        return f"{part}, may be {1e3 * self.far_m:.0f} mm off"


@dataclass(frozen=True)
class LabelQuality:
    """Quality of one label.

    Attributes:
        expected_error_mm: expected mean vertex error [mm]; NaN if nothing was seen.
        misplaced: part of the mesh that contradicts the observation.
        idle_pickers: pickers of the action that held no cloth.
    """

    action: int
    frame: int
    expected_error_mm: float
    evidence: LabelEvidence
    misplaced: Misplaced = Misplaced()
    idle_pickers: tuple[str, ...] = ()


def judge_labels(
    tracked: TrackedTrajectory,
    recording: Recording,
    model: QualityModel | None = None,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
) -> tuple[LabelQuality, ...]:
    """Estimate the quality of every label of a tracked trajectory from the observation.

    Args:
        tracked: the tracked trajectory.
        recording: recording that it was tracked from.
        model: quality model; the shipped one by default.
        segmenter: segmentation of the cloth; the recording's own by default.
        device: "cpu" or "cuda:0", for visibility.

    Raises:
        InvalidResultError: trajectory and recording do not belong together.
    """
    model = model or shipped_model()
    labels = labels_of(tracked)
    evidence = label_evidence(tracked.mesh, labels, recording, segmenter=segmenter, device=device)
    return tuple(
        LabelQuality(
            one.action - 1,
            label.frame,
            1e3 * model.expected_error_m(one),
            one,
            _misplaced(label.vertices, one.misfit, recording),
            _idle_pickers(tracked, recording, one.action - 1),
        )
        for label, one in zip(labels, evidence, strict=True)
    )


def left_behind(
    tracked: TrackedTrajectory,
    recording: Recording,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
) -> tuple[tuple[int, Misplaced], ...]:
    """Return a frame after each action, and the part of the mesh that is misplaced by then.

    The mesh rests from the last frame of an action to the next action, or to the end of the
    recording. Cloth that moves meanwhile leaves the mesh behind. Actions without frames after them
    are left out.
    """
    ends = [*(action.first_frame for action in tracked.actions), len(recording.frames) - 1][1:]
    found = []
    for label, end in zip(labels_of(tracked), ends, strict=True):
        if end - label.frame < _FEWEST_FRAMES_AFTER:
            continue
        try:
            misfit = misfit_at(
                tracked.mesh, label.vertices, recording, end, segmenter=segmenter, device=device
            )
        except ClothTrackError:
            continue  # The cloth is not found there, so nothing can be measured.
        found.append((end, _misplaced(label.vertices, misfit, recording)))
    return tuple(found)


def _misplaced(
    vertices: Float[np.ndarray, "vertices 3"], misfit: LocalMisfit | None, recording: Recording
) -> Misplaced:
    if misfit is None:
        return Misplaced()
    far = misfit.patch_m > FAR_M
    if not far.any():
        return Misplaced()
    off_m = float(np.percentile(misfit.patch_m[far], 90))
    return Misplaced(float(far.mean()), off_m, place_of(vertices, far, recording.cameras))


def _idle_pickers(tracked: TrackedTrajectory, recording: Recording, action: int) -> tuple[str, ...]:
    """Return the pickers of an action that held no cloth."""
    names = recording.actions[action].pickers if action < len(recording.actions) else ()
    held = tracked.actions[action].held_vertices
    return tuple(name for name in names if not held.get(name))


@cache
def shipped_model() -> QualityModel:
    """Return the model that comes with the package."""
    return QualityModel.load()


def fit_quality(
    evidence: Sequence[LabelEvidence],
    errors_m: Float[np.ndarray, " labels"],
    *,
    shrinkage: float = SHRINKAGE,
    provenance: Mapping[str, Any] | None = None,
) -> QualityModel:
    """Fit the model by non-negative ridge regression of the logarithm of the error.

    The evidence is first scaled to unit deviation, so that `shrinkage` treats all pieces alike.
    Labels with missing evidence are left out.

    Args:
        errors_m: their true mean vertex errors [m].
    """
    terms = np.array([_terms(one) for one in evidence]).reshape(-1, len(EVIDENCE_NAMES))
    known = np.isfinite(terms).all(axis=1)
    terms, errors = terms[known], np.asarray(errors_m, np.float64)[known]
    if len(errors) < 3 or not (errors > 0).all():
        raise InvalidConfigError(
            f"{len(errors)} labels with all evidence, smallest error "
            f"{errors.min(initial=math.inf)} m; a fit needs three labels and positive errors"
        )
    logs = np.log(errors)
    spread = terms.std(axis=0)
    spread[spread < 1e-9] = np.inf
    scaled = (terms - terms.mean(axis=0)) / spread
    ridge = math.sqrt(shrinkage * len(logs)) * np.eye(len(spread))
    wanted = np.concatenate([logs - logs.mean(), np.zeros(len(spread))])
    weights = nnls(np.vstack([scaled, ridge]), wanted)[0] / spread
    return QualityModel(
        log_error=float(logs.mean() - terms.mean(axis=0) @ weights),
        weights=dict(zip(EVIDENCE_NAMES, weights.tolist(), strict=True)),
        provenance=provenance or {},
    )


def _terms(evidence: LabelEvidence) -> list[float]:
    """Return ln(1 + evidence / scale) for each piece, in the order of EVIDENCE_NAMES."""
    values = evidence.as_dict()
    return [math.log1p(values[name] / SCALES[name]) for name in EVIDENCE_NAMES]


_SPREAD_SHARE = 0.8
"""Share of the expected error that is distributed by the spread; the rest is uniform."""

INTERVAL_FACTOR = 1.9
"""90 % of the vertices have an error of at most this factor times their expected error. Fitted on
the labels of the benchmark's split `dev` (docs/label_quality.md), without a Gaussian assumption."""


def expected_vertex_errors(
    action: TrackedAction, label: LabelQuality
) -> Float[np.ndarray, " vertices"]:
    """Return the expected error of each vertex of a label [m].

    Their mean is the label's expected error, or more if the observation contradicts the mesh.
    """
    expected_m = 1e-3 * label.expected_error_mm
    spread_m, vertices = action.calibration.spread_m, len(action.positions_after_final_alignment)
    mean_m = float(spread_m.mean()) if len(spread_m) else 0.0
    dealt = np.full(vertices, expected_m)
    if mean_m > 0.0:
        dealt = expected_m * (1.0 - _SPREAD_SHARE + _SPREAD_SHARE * spread_m / mean_m)
    misfit = label.evidence.misfit
    return dealt if misfit is None else np.maximum(dealt, misfit.patch_m)
