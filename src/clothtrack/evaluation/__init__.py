"""Measures of a tracked trajectory, with and without truth, and their tables."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.evaluation.label_evidence import LabelEvidence, labels_of
    from clothtrack.evaluation.label_quality import LabelQuality, QualityModel, judge_labels
    from clothtrack.evaluation.label_review import LabelReview, read_review, review_path
    from clothtrack.evaluation.label_selection import pseudo_labels_of
    from clothtrack.evaluation.metrics import (
        ClothMeasures,
        ErrorSummary,
        chamfer_pc,
        chamfer_surface,
        cloth_measures,
        vertex_error_mm,
    )
    from clothtrack.evaluation.results import Evaluation, Row, as_json, evaluate, table
    from clothtrack.evaluation.truth import Truth, material_map, material_points
    from clothtrack.evaluation.verdict import Verdict, trajectory_verdict
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "ClothMeasures",
    "ErrorSummary",
    "Evaluation",
    "LabelEvidence",
    "LabelQuality",
    "LabelReview",
    "QualityModel",
    "Row",
    "Truth",
    "Verdict",
    "as_json",
    "chamfer_pc",
    "chamfer_surface",
    "cloth_measures",
    "evaluate",
    "judge_labels",
    "labels_of",
    "material_map",
    "material_points",
    "pseudo_labels_of",
    "read_review",
    "review_path",
    "table",
    "trajectory_verdict",
    "vertex_error_mm",
]
