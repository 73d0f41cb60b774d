"""The columns of the tables about the network, and what fine-tuning has gained."""

from collections.abc import Mapping, Sequence

import numpy as np

from shared.bench_measures import Row
from shared.table_column import Column, table

CHAMFER_PC = Column("Chamfer PC", "chamfer_pc_m2", 1e4, 2, spread=True)
CHAMFER_LABEL = Column("Chamfer Mesh, label", "chamfer_label_m2", 1e4, 2)
CHAMFER_TRUTH = Column("Chamfer Mesh, truth", "chamfer_surface_m2", 1e4, 2)
FLOOR = Column("floor", "chamfer_floor_m2", 1e4, 2)
SYMMETRIC = Column("error mm, up to symmetry", "error_symmetric_mm", spread=True)
SYMMETRIC_VISIBLE = Column("visible", "error_symmetric_visible_mm")
SYMMETRIC_HIDDEN = Column("hidden", "error_symmetric_hidden_mm")
DRAWN = Column("error as named", "error_all_mm")
CANONICAL = Column("canonical error mm, median", "canonical_median_mm")
CANONICAL_MEAN = Column("mean", "canonical_mean_mm")
HAS_MESH = Column("has a mesh %", "has_mesh", 100, 0)
STRAIN = Column("strain %", "edge_strain", 100, 2)
CROSSINGS_RATE = Column("crossings per 1,000 edges", "crossings_per_1000_edges", digits=2)
CPU = Column("CPU s", "cpu_s", digits=2)

CHAMFER_LAST = Column(
    "Chamfer, last action", "chamfer_pc_m2", 1e4, 2, "before", last=True, spread=True
)
CHAMFER = Column("Chamfer, all actions", "chamfer_pc_m2", 1e4, 2, "before")

LEARNED = (
    CHAMFER_PC, FLOOR, CHAMFER_LABEL, CHAMFER_TRUTH, SYMMETRIC, SYMMETRIC_VISIBLE,
    SYMMETRIC_HIDDEN, DRAWN, CANONICAL, CANONICAL_MEAN, STRAIN, CROSSINGS_RATE,
)  # fmt: skip
LEARNING_COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "table2": LEARNED,
    "label_count": LEARNED,
    "network_alone": (
        CHAMFER_LAST, CHAMFER, FLOOR, DRAWN, Column("visible", "error_visible_mm"),
        Column("hidden", "error_hidden_mm"), Column("95 %", "error_all_p95_mm"), SYMMETRIC,
        CHAMFER_TRUTH, STRAIN, CROSSINGS_RATE, HAS_MESH, CPU,
    ),
}  # fmt: skip
LEARNING_TITLES: Mapping[str, str] = {
    "table2": "Table 2: before and after fine-tuning, on held-out trajectories",
    "label_count": "How many trajectories are needed",
    "network_alone": "Table 1's other side: the network alone",
}
LEARNING_PAIRED: Mapping[str, tuple[Column, ...]] = {
    "table2": (CHAMFER_PC, SYMMETRIC),
    "label_count": (CHAMFER_PC, SYMMETRIC),
    "network_alone": (CHAMFER_LAST, SYMMETRIC),
}

BEFORE, DEFAULT, TRUTH = "before", "labels: default, weighted", "labels: the truth"
TARGETS = {CHAMFER_PC: 46.0, CHAMFER_LABEL: 45.0, CHAMFER_TRUTH: 45.0, SYMMETRIC: 25.0}
"""By how much fine-tuning on our labels is to lower each measure [%]: the paper's, and our own."""


def gains(rows: Sequence[Row]) -> str:
    """By how much each kind of label lowers each measure [%], on the recordings that all have.

    And how far fine-tuning on our labels stays behind fine-tuning on the truth.
    """
    variants = [v for v in dict.fromkeys(str(row["variant"]) for row in rows) if v != BEFORE]
    lines = [
        [variant, *(_percent(rows, column, variant, BEFORE) for column in TARGETS)]
        for variant in variants
    ]
    lines.append(["target", *(f"{target:.0f}" for target in TARGETS.values())])
    parts = ["Lower than before fine-tuning [%]:"]
    parts.append(table(["learned from", *(column.title for column in TARGETS)], lines))
    behind = _ratio(rows, SYMMETRIC, DEFAULT, TRUTH)
    if behind is not None:
        parts.append(
            "The error up to symmetry after fine-tuning on our labels, against that after "
            f"fine-tuning on the truth: {100.0 * (behind - 1.0):+.0f} % (target: +15 % or less)."
        )
    return "\n\n".join(parts)


def _percent(rows: Sequence[Row], column: Column, variant: str, reference: str) -> str:
    ratio = _ratio(rows, column, variant, reference)
    return "-" if ratio is None else f"{100.0 * (1.0 - ratio):.0f}"


def _ratio(rows: Sequence[Row], column: Column, variant: str, reference: str) -> float | None:
    """Ratio of the means over the recordings that both have; None without such a recording."""
    ours, theirs = (
        column.values(row for row in rows if row["variant"] == name)
        for name in (variant, reference)
    )
    both = [name for name in ours if name in theirs]
    if not both:
        return None
    below = float(np.mean([theirs[name] for name in both]))
    return float(np.mean([ours[name] for name in both])) / below if below > 0.0 else None
