"""Rows of measures, one per action and stage, with the provenance to reproduce them."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from textwrap import wrap
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from clothtrack._shown import short_repr
from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_evidence import LabelEvidence
from clothtrack.evaluation.label_quality import LabelQuality, Misplaced, judge_labels
from clothtrack.evaluation.metrics import (
    ClothMeasures,
    ErrorSummary,
    chamfer_pc,
    chamfer_surface,
    cloth_measures,
    cloud_floor,
    root_mean_square_mm,
    vertex_error_mm,
)
from clothtrack.evaluation.naming import Where, true_places
from clothtrack.evaluation.truth import Truth, material_points
from clothtrack.evaluation.verdict import LIMITS, NO_ACTION, Verdict, verdict_of
from clothtrack.files.settings import from_plain as from_stored
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import MODES, RunConfig
from clothtrack.tracking.tracked_trajectory import TrackedAction, TrackedTrajectory

Stage = Literal["before_final_alignment", "after_final_alignment"]
STAGES: tuple[Stage, ...] = ("before_final_alignment", "after_final_alignment")


@dataclass(frozen=True)
class Row:
    """Measures of the mesh at the end of an action, before or after the final alignment.

    The paper measures before. The mesh after it starts the next action and becomes a pseudo-label.

    Attributes:
        method: named mode of the tracker, or "custom".
        chamfer_pc: visible vertices against the cloud [m^2].
        chamfer_pc_rms_mm: root of half of it [mm].
        chamfer_floor: the same for the truth, or between two halves of the cloud [m^2].
        chamfer_surface: whole surface against the true one [m^2]; NaN without truth.
        vertex_error_mm: errors of "all", "visible", "hidden" vertices; empty without truth.
    """

    recording: str
    method: str
    action: int
    frame: int
    stage: Stage
    chamfer_pc: float
    chamfer_pc_rms_mm: float
    chamfer_floor: float
    floor_of: str
    chamfer_surface: float
    vertex_error_mm: Mapping[str, ErrorSummary]
    cloth: ClothMeasures


@dataclass(frozen=True)
class Evaluation:
    """The rows of one tracked trajectory.

    Attributes:
        rows: measures per action, before and after the final alignment.
        labels: quality of the mesh after the final alignment, per action; estimated from the
            observation without the truth.
        verdicts: the verdict on each of these labels.
        provenance: commit, configuration hash, versions, seed and device of the tracking run.
    """

    name: str
    rows: tuple[Row, ...]
    labels: tuple[LabelQuality, ...] = ()
    verdicts: tuple[Verdict, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = short_repr

    def __str__(self) -> str:
        """Return a readable summary, one line per action."""
        return summary([self])


@dataclass(frozen=True, eq=False)
class _Reference:
    """Reference data for the mesh at one frame."""

    observation: Observation
    floor: float
    floor_of: str
    surface: tuple[np.ndarray, np.ndarray] | None
    true_points: Float[np.ndarray, "vertices 3"] | None
    truly_visible: Bool[np.ndarray, " vertices"] | None


def evaluate(
    tracked: TrackedTrajectory,
    recording: Recording,
    truth: Truth | None = None,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
    seed: int = 0,
) -> Evaluation:
    """Measure a tracked trajectory at the end of each action."""
    if tracked.actions and tracked.actions[-1].last_frame >= len(recording.frames):
        raise InvalidResultError(
            f"{tracked.name}: an action ends at frame {tracked.actions[-1].last_frame}, but "
            f"{recording.folder} has {len(recording.frames)} frames; give the recording that it "
            "was tracked from"
        )
    rows: list[Row] = []
    where = None if truth is None else true_places(tracked, truth)
    for number, action in enumerate(tracked.actions):
        frame = recording.frames[action.last_frame]
        observation = observe(recording, frame, segmenter)
        reference = _reference(tracked, action, observation, truth, where, device=device, seed=seed)
        for stage in STAGES:
            vertices = np.asarray(getattr(action, f"positions_{stage}"), np.float64)
            row = _row(
                tracked, recording, (number, stage), vertices, reference, device=device, seed=seed
            )
            rows.append(row)
    labels = judge_labels(tracked, recording, segmenter=segmenter, device=device)
    whole = verdict_of(tracked, recording, labels, segmenter=segmenter, device=device)
    verdicts = tuple(whole.of_label(one.action) for one in labels)
    return Evaluation(tracked.name, tuple(rows), labels, verdicts, tracked.provenance)


def observed_chamfer(
    vertices: Float[np.ndarray, "vertices 3"],
    seen: Bool[np.ndarray, " vertices"],
    observation: Observation,
) -> float:
    """Return the two-way Chamfer distance of visible vertices and observation [m^2].

    Vertices in unobservable regions (`Observation.unobservable`) are left out because a missing
    cloud point says nothing about them. NaN if nothing is visible or observed.

    Args:
        vertices: vertices of the mesh, in the world [m].
    """
    return chamfer_pc(vertices, seen & ~observation.unobservable(vertices), observation.points)


def method_name(config: RunConfig) -> str:
    """Return the named mode that matches a run, except for seed, first mesh and cloud spacing."""
    own = {name: getattr(config, name) for name in ("seed", "initial_state", "cloud_spacing_m")}
    return next((name for name, one in MODES.items() if replace(one, **own) == config), "custom")


def _settings(tracked: TrackedTrajectory) -> RunConfig:
    """Return the settings of a run; the default ones if none are stored."""
    try:
        return from_stored(RunConfig(), tracked.config) if tracked.config else RunConfig()
    except InvalidConfigError as error:
        raise InvalidResultError(
            f"{tracked.name}: its settings are of another version ({error}); track the recording "
            "again"
        ) from error


def _reference(
    tracked: TrackedTrajectory,
    action: TrackedAction,
    observation: Observation,
    truth: Truth | None,
    where: Where | None,
    *,
    device: str,
    seed: int,
) -> _Reference:
    surface = None if truth is None else truth.at(action.last_frame)
    if truth is None or surface is None:
        floor = cloud_floor(observation.points, seed)
        return _Reference(observation, floor, "cloud halves", None, None, None)
    pair = (surface, truth.faces)
    if where is None:
        floor = cloud_floor(observation.points, seed)
        return _Reference(observation, floor, "cloud halves", pair, None, None)
    points = material_points(surface, truth.faces, where)
    faces, cameras = tracked.mesh.faces, observation.cameras
    seen = visible_vertices(points, faces, cameras, device=device)
    floor = observed_chamfer(points, seen, observation)
    true_seen = visible_vertices(surface, truth.faces, cameras, device=device)
    share = np.einsum("ij,ij->i", where[1], true_seen[truth.faces[where[0]]].astype(float))
    return _Reference(observation, floor, "truth", pair, points, share > 0.5)


def _row(
    tracked: TrackedTrajectory,
    recording: Recording,
    which: tuple[int, Stage],
    vertices: Float[np.ndarray, "vertices 3"],
    reference: _Reference,
    *,
    device: str,
    seed: int,
) -> Row:
    faces, observation = tracked.mesh.faces, reference.observation
    seen = visible_vertices(vertices, faces, observation.cameras, device=device)
    chamfer = observed_chamfer(vertices, seen, observation)
    errors: dict[str, ErrorSummary] = {}
    if reference.true_points is not None and reference.truly_visible is not None:
        errors = vertex_error_mm(vertices, reference.true_points, reference.truly_visible)
    surface = float("nan")
    if reference.surface is not None:
        surface = chamfer_surface((vertices, faces), reference.surface, seed=seed)
    (number, stage), config = which, _settings(tracked)
    return Row(
        recording=tracked.name,
        method=method_name(config),
        action=number,
        frame=tracked.actions[number].last_frame,
        stage=stage,
        chamfer_pc=chamfer,
        chamfer_pc_rms_mm=root_mean_square_mm(chamfer),
        chamfer_floor=reference.floor,
        floor_of=reference.floor_of,
        chamfer_surface=surface,
        vertex_error_mm=errors,
        cloth=cloth_measures(
            tracked.mesh,
            vertices,
            recording.table,
            rest_height_m=0.5 * config.cloth.thickness_m,
        ),
    )


def as_json(evaluations: Sequence[Evaluation]) -> str:
    """Return all rows, verdicts and their provenance as JSON; NaN becomes null."""
    return json.dumps([as_plain(one) for one in evaluations], indent=2, allow_nan=False)


def as_plain(evaluation: Evaluation) -> dict[str, Any]:
    """Return an evaluation as plain JSON values, with a verdict on every label."""
    judged = zip(evaluation.labels, evaluation.verdicts, strict=True)
    verdicts = [{"action": one.action, **found.as_dict()} for one, found in judged]
    numbers = tuple(
        replace(one, evidence=replace(one.evidence, misfit=None)) for one in evaluation.labels
    )
    return _plain({**asdict(replace(evaluation, labels=numbers)), "verdicts": verdicts})


def from_plain(document: Mapping[str, Any]) -> Evaluation:
    """Return the evaluation that `as_plain` wrote."""

    def numbers(values: Mapping[str, Any]) -> dict[str, Any]:
        return {name: np.nan if value is None else value for name, value in values.items()}

    rows = []
    for row in document["rows"]:
        errors = {
            name: ErrorSummary(**numbers(one)) for name, one in row["vertex_error_mm"].items()
        }
        cloth = ClothMeasures(**numbers(row["cloth"]))
        rows.append(Row(**{**numbers(row), "vertex_error_mm": errors, "cloth": cloth}))
    labels = [
        LabelQuality(
            **{
                **numbers(one),
                "evidence": LabelEvidence(**numbers(one["evidence"]) | {"misfit": None}),
                "misplaced": Misplaced(**one.get("misplaced", {})),
                "idle_pickers": tuple(one.get("idle_pickers", ())),
            }
        )
        for one in document["labels"]
    ]
    verdicts = tuple(Verdict.from_dict(one) for one in document["verdicts"])
    return Evaluation(
        document["name"], tuple(rows), tuple(labels), verdicts, document["provenance"]
    )


def summary(evaluations: Iterable[Evaluation]) -> str:
    """Return one line per action, in 80 columns, with the verdict on its label and the reason."""
    lines = [
        f"{'recording':24} {'action':>6} {'distance':>9} {'floor':>6} {'expected':>9} {'true':>6}"
        "  verdict"
    ]
    reasons = []
    for evaluation in evaluations:
        actions = (one.action for one in evaluation.labels)
        judged = dict(zip(actions, evaluation.verdicts, strict=True))
        if not evaluation.rows:
            reasons.append(f"{evaluation.name}: look: {NO_ACTION}")
        for row in evaluation.rows:
            if row.stage != "after_final_alignment":
                continue
            found, true = judged.get(row.action), row.vertex_error_mm.get("all")
            expected = 1e3 * found.expected_error_m if found else np.nan
            lines.append(
                f"{row.recording[:24]:24} {row.action + 1:>6} {row.chamfer_pc_rms_mm:>9.1f} "
                f"{root_mean_square_mm(row.chamfer_floor):>6.1f} {_or_dash(expected):>9} "
                f"{_or_dash(true.mean if true and true.count else np.nan):>6}  "
                f"{found.word if found else '-'}"
            )
            told = [found.reason] if found and found.word != "trust" else []
            if true and true.count and true.mean > max(EXCHANGED_MM, EXCHANGED_TIMES * expected):
                told.append(_EXCHANGED)
            for reason in told:
                line = f"{row.recording}, action {row.action + 1}: {reason}"
                reasons += wrap(line, 80, subsequent_indent="  ")
    return "\n".join([*lines, *reasons, _SUMMARY_LEGEND])


EXCHANGED_MM, EXCHANGED_TIMES = 50.0, 10.0
"""A true error above both limits, in mm and in expected errors, is hardly a tracking error."""

_EXCHANGED = (
    "the true error is many times the expected one: corners or sides may have other names "
    "than the truth's (docs/faq.md)"
)

_SUMMARY_LEGEND = (
    "[mm] distance: mesh to cloud; floor: that of a right mesh; expected: error of a\n"
    "vertex, judged without truth; true: with it. trust: use the label, expected is\n"
    f"at most {1e3 * LIMITS['expected error'].look:g} and nothing speaks against it; look: see it "
    "first; reject: leave\nit out. --all shows every measure."
)


def _or_dash(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"


def table(evaluations: Iterable[Evaluation]) -> str:
    """Return the rows as text, one line per action and stage, with a legend."""
    lines = [_HEADER]
    for evaluation in evaluations:
        judged = {one.action: one for one in evaluation.labels}
        for row in evaluation.rows:
            label = judged.get(row.action) if row.stage == "after_final_alignment" else None
            errors = [row.vertex_error_mm.get(key) for key in ("all", "visible", "hidden")]
            means = [f"{one.mean:.1f}" if one and one.count else "-" for one in errors]
            p95 = f"{errors[0].p95:.1f}" if errors[0] else "-"
            lines.append(
                f"{row.recording[:22]:22} {row.action + 1:>3} {row.stage.split('_')[0]:6} "
                f"{1e4 * row.chamfer_pc:7.3f} {1e4 * row.chamfer_floor:7.3f} "
                f"{row.chamfer_pc_rms_mm:6.2f}  {means[0]:>6} {means[1]:>7} {means[2]:>6} {p95:>6} "
                f"{100 * row.cloth.edge_strain:7.2f} {row.cloth.crossings:6d} "
                f"{row.cloth.close_pairs:6d} {_percent(row.cloth.below_table):>6} "
                f"{1e4 * row.cloth.coverage:9.1f}  {_judged(label)}"
            )
    return "\n".join([*lines, _LEGEND])


_HEADER = (
    f"{'recording':22} {'act':>3} {'TTO2':6} {'Ch.PC':>7} {'floor':>7} {'rms':>6}  "
    f"{'error':>6} {'visible':>7} {'hidden':>6} {'p95':>6} "
    f"{'strain':>7} {'cross':>6} {'close':>6} {'below':>6} {'coverage':>9}  {'expect':>6}"
)
_LEGEND = (
    "Ch.PC, floor [1e-4 m^2]; rms and vertex errors against the truth [mm], '-' without truth; "
    "strain, below [%]; coverage [cm^2]; TTO2: before or after the final alignment; expect: error "
    "of the label to expect from what is observed [mm]"
)


def _judged(label: LabelQuality | None) -> str:
    if label is None or np.isnan(label.expected_error_mm):
        return f"{'-':>6}"
    return f"{label.expected_error_mm:6.1f}"


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.1f}"


def _plain(value: Any) -> Any:
    """Return the value as plain JSON values; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
