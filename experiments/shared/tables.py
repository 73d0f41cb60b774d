"""The tables of the experiments as Markdown, with our numbers next to the paper's.

One line per method. Of the leading measures: mean and standard deviation over the recordings (each
the mean of its actions), median, and how many. Chamfer distances are squared means of both
directions summed [1e-4 m^2], before TTO2, beside the floor that the truth itself scores; errors are
mean distances to the true material points [mm], after TTO2 where a method has one.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from shared.bench_measures import Row
from shared.flattening_columns import (
    FLATTENING_COLUMNS,
    FLATTENING_PAIRED,
    FLATTENING_TITLES,
    curve,
    promises,
    targets,
)
from shared.table_column import Column, paired, table

PAPER: Mapping[str, Mapping[str, float]] = {
    "table1": {
        "paper": 1.13,
        "no_pseudo_action": 1.62,
        "no_dynamics_initialization": 1.40,
        "no_action_conditioning": 3.72,
        "no_final_alignment": 2.19,
        "reconstruction_network": 3.0,
    },
    "calibration": {"paper, online": 1.13, "paper, offline": 1.90},
    "final_alignment": {
        "best, with TTO2": 1.13,
        "50 %, with TTO2": 1.18,
        "90 %, with TTO2": 1.35,
        "best, without TTO2": 2.19,
        "50 %, without TTO2": 2.67,
        "90 %, without TTO2": 2.85,
    },
    "collision": {"paper, with rigidity": 4099, "paper, without rigidity": 33765},
    "network_alone": {"network, implicit, fine-tuned at test time": 3.0},
}
"""What the paper states (Huang, Lin and Held, arXiv 2302.09502), by experiment and method: Chamfer
distances in 1e-4 m^2, of the last action before TTO2. The paper prints "1e-4 m", but its base model
sums mean squared distances. Cloth and recordings are its own: only the order can be compared."""


CHAMFER_LAST = Column(
    "Chamfer, last action", "chamfer_pc_m2", 1e4, 2, "before", last=True, spread=True
)
CHAMFER = Column("Chamfer, all actions", "chamfer_pc_m2", 1e4, 2, "before")
CHAMFER_AFTER = Column("after TTO2", "chamfer_pc_m2", 1e4, 2)
FLOOR = Column("floor", "chamfer_floor_m2", 1e4, 2, "before")
ERROR = Column("error mm", "error_all_mm", spread=True)
ERROR_BEFORE = Column("error before TTO2", "error_all_mm", stage="before")
VISIBLE = Column("visible", "error_visible_mm")
HIDDEN = Column("hidden", "error_hidden_mm")
P95 = Column("95 %", "error_all_p95_mm")
STRAIN = Column("strain %", "edge_strain", 100, 2)
CROSSINGS = Column("crossings", "crossings", spread=True)
CROSSINGS_RATE = Column("per 1,000 edges", "crossings_per_1000_edges", digits=2)
WORLD_CROSSINGS = Column("world's own", "world_crossings_per_1000_edges", digits=2)
PAIRS_BEFORE = Column("pairs < 5 mm before TTO2", "close_pairs", stage="before", digits=0)
PAIRS = Column("pairs < 5 mm", "close_pairs", digits=0, spread=True)
PAIRS_RATE = Column("per 1,000 vertices", "close_pairs_per_1000_vertices", digits=0)
PAIRS_TRUTH = Column("truth on these vertices", "truth_close_pairs", digits=0)
SWAPPED = Column("layers swapped %", "share_swapped", 100, 1)
BELOW = Column("below table %", "below_table", 100, 1)
CPU = Column("CPU s", "cpu_s", digits=0)
SYMMETRIC = Column("error mm, up to symmetry", "error_symmetric_mm", spread=True)

LEADING = (CHAMFER_LAST, CHAMFER, CHAMFER_AFTER, FLOOR, ERROR, VISIBLE, HIDDEN, P95)
COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "table1": (*LEADING, STRAIN, CROSSINGS_RATE, WORLD_CROSSINGS, SWAPPED, BELOW, CPU),
    "default_ablations": (*LEADING, STRAIN, CROSSINGS_RATE, WORLD_CROSSINGS, SWAPPED, CPU),
    "calibration": (CHAMFER_LAST, CHAMFER, FLOOR, ERROR, VISIBLE, HIDDEN, CPU),
    "printed_grid": (CHAMFER_LAST, CHAMFER, FLOOR, ERROR, VISIBLE, HIDDEN, CPU),
    "final_alignment": (CHAMFER_LAST, CHAMFER, CHAMFER_AFTER, FLOOR, ERROR_BEFORE, ERROR, HIDDEN),
    "collision": (
        PAIRS, PAIRS_RATE, PAIRS_TRUTH, PAIRS_BEFORE, CROSSINGS, CROSSINGS_RATE, WORLD_CROSSINGS,
        SWAPPED, CHAMFER_LAST, FLOOR, ERROR, STRAIN,
    ),
    "sensitivity": (
        ERROR, VISIBLE, HIDDEN, P95, CHAMFER_LAST, FLOOR, STRAIN, CROSSINGS_RATE, CPU
    ),
    "model_free": (*LEADING, STRAIN, CROSSINGS_RATE, WORLD_CROSSINGS, SWAPPED, CPU),
    "network_alone": (
        CHAMFER_LAST, CHAMFER, Column("floor", "chamfer_floor_m2", 1e4, 2),
        Column("error as named", "error_all_mm"), VISIBLE, HIDDEN, P95, SYMMETRIC,
        Column("Chamfer Mesh, truth", "chamfer_surface_m2", 1e4, 2), STRAIN,
        Column("crossings per 1,000 edges", "crossings_per_1000_edges", digits=2),
        Column("has a mesh %", "has_mesh", 100, 0), Column("CPU s", "cpu_s", digits=2),
    ),
    **FLATTENING_COLUMNS,
}  # fmt: skip
TITLES = {
    "table1": "Table 1: what each part of the method is worth",
    "default_ablations": "From the paper's method to the default, and the default ablated",
    "calibration": "Calibration: online against offline",
    "printed_grid": "Calibration: the paper's printed grid against descent",
    "final_alignment": "TTO2 against a bad calibration",
    "collision": "Collision: with and without the rigidity loss",
    "sensitivity": "Sensitivity: one setting at a time",
    "model_free": "Why a simulator? A model-free peer",
    "network_alone": "Table 1's other side: the network alone",
    **FLATTENING_TITLES,
}
REFERENCES: Mapping[str, tuple[str, ...]] = {
    "table1": ("paper",),
    "default_ablations": ("default",),
    "calibration": ("paper, online", "default, online"),
    "printed_grid": ("descent",),
    "final_alignment": ("best, with TTO2",),
    "collision": ("paper, with rigidity", "default, with rigidity"),
    "model_free": ("default",),
    "network_alone": ("network, template",),
    "flattening": ("random",),
    "planning_dynamics": ("simulator",),
}
"""What the others are paired with; of several, each with those that begin like it."""

PAIRED = (CHAMFER_LAST, ERROR)
_PAIRED = {"network_alone": (CHAMFER_LAST, SYMMETRIC), **FLATTENING_PAIRED}


def markdown(experiment: str, rows: Sequence[Row]) -> str:
    """Return the tables of one experiment as Markdown: means, pairs, actions, and what failed."""
    good = [row for row in rows if "error" not in row]
    variants = list(dict.fromkeys(str(row["variant"]) for row in rows))
    parts = [f"## {TITLES[experiment]}", about(good)]
    for heading, chosen in _groups(variants):
        parts += [heading] if heading else []
        parts.append(means(experiment, good, chosen))
    references = REFERENCES.get(experiment, ())
    for reference in references:
        like = reference.partition(",")[0] if len(references) > 1 else ""
        chosen = [variant for variant in variants if variant.startswith(like)]
        if reference in chosen and len(chosen) > 1:
            parts += [
                f"Paired by recording, minus *{reference}* (mean ± standard error):",
                pairs(good, chosen, reference, _PAIRED.get(experiment, PAIRED)),
            ]
    parts += _BELOW.get(experiment, _by_action_and_garment)(good, variants)
    return _with_failures(parts, rows)


def _by_action_and_garment(rows: Sequence[Row], variants: Sequence[str]) -> list[str]:
    parts = []
    if any(row["actions"] > 1 for row in rows):
        parts += ["Error by action [mm], all vertices / hidden:", by_action(rows, variants)]
    if len({row["kind"] for row in rows}) > 1:
        parts += ["Error by garment [mm], all vertices / visible / hidden:", by_garment(rows)]
    return parts


def _improvement_by_action(rows: Sequence[Row], variants: Sequence[str]) -> list[str]:
    heading = "Mean normalized improvement after each action:"
    return [heading, curve(rows, variants), targets(rows)]


def _promises_by_choice(rows: Sequence[Row], variants: Sequence[str]) -> list[str]:
    heading = "Rank correlation of promised and true gains over actions chosen by (how many):"
    return [heading, promises(rows, variants)]


_BELOW: Mapping[str, Callable[[Sequence[Row], Sequence[str]], list[str]]] = {
    "flattening": _improvement_by_action,
    "planning_dynamics": _promises_by_choice,
}
"""What stands below the means and the pairs, where it is not the error by action and garment."""


def _with_failures(parts: list[str], rows: Sequence[Row]) -> str:
    """Return the parts of a text, and what failed."""
    failed = [row for row in rows if "error" in row]
    text = [f"- failed: {r['variant']}, {r['recording']}: {r['error']}" for r in failed]
    return "\n\n".join(part for part in (*parts, *text) if part) + "\n"


def about(rows: Sequence[Row]) -> str:
    """Return how many recordings of which split, and at which commits and versions."""
    names = dict.fromkeys((row["recording"], row["split"]) for row in rows)
    splits = sorted({str(split) for _, split in names if split})
    stamps = [row["provenance"] for row in rows if row.get("provenance")]
    commits = sorted({str(stamp["commit"]) for stamp in stamps})
    versions = sorted({str(stamp["clothtrack"]) for stamp in stamps})
    vertices = [int(row["vertices"]) for row in rows if "vertices" in row]
    text = f"{len(names)} recording{'s' if len(names) != 1 else ''}" + (
        f" of the split {', '.join(splits)}" if splits else ""
    )
    if vertices:
        ends = dict.fromkeys((min(vertices), max(vertices)))
        text += f", {' to '.join(map(str, ends))} vertices"
    return text + f"; clothtrack {', '.join(versions) or '?'} at {', '.join(commits) or '?'}."


def means(experiment: str, rows: Sequence[Row], variants: Sequence[str]) -> str:
    """Return one line per variant: the paper's number, how many recordings, every column."""
    columns = COLUMNS[experiment]
    paper = PAPER.get(experiment, {})
    titles = [title for column in columns for title in column.titles]
    stated = {"paper": paper} if any(variant in paper for variant in variants) else {}
    head = ["method", *stated, "n", *titles]
    lines = []
    for variant in variants:
        chosen = [row for row in rows if row["variant"] == variant]
        cells = [cell for column in columns for cell in column.cells(chosen)]
        papers = [f"{own[variant]:,g}" if variant in own else "-" for own in stated.values()]
        count = len({row["recording"] for row in chosen})
        lines.append([variant, *papers, str(count), *cells])
    return table(head, lines)


def pairs(
    rows: Sequence[Row],
    variants: Sequence[str],
    reference: str,
    columns: Sequence[Column] = PAIRED,
) -> str:
    """Return differences to the reference on the same recordings, and in how many it is lower."""
    lines = []
    for variant in variants:
        if variant == reference:
            continue
        line = [variant]
        for column in columns:
            gaps = differences(rows, variant, reference, column)
            if not len(gaps):
                line += ["-", "-"]
                continue
            line += paired(gaps, column.digits)
        lines.append(line)
    head = ["method"]
    for column in columns:
        head += [column.title, "lower in"]
    return table(head, lines)


def differences(rows: Sequence[Row], variant: str, reference: str, column: Column) -> np.ndarray:
    """Return the variant's value minus the reference's, per recording that both have."""
    ours, theirs = (
        column.values(row for row in rows if row["variant"] == name)
        for name in (variant, reference)
    )
    return np.array([ours[name] - theirs[name] for name in ours if name in theirs])


def by_action(
    rows: Sequence[Row], variants: Sequence[str], columns: Sequence[Column] | None = None
) -> str:
    """Return errors per action, which show the drift of a method."""
    actions = sorted({int(row["action"]) for row in rows})
    lines = []
    for variant in variants:
        line = [variant]
        for action in actions:
            chosen = [r for r in rows if (r["variant"], r["action"]) == (variant, action)]
            line.append(" / ".join(each.cells(chosen)[0] for each in columns or (_ALL, HIDDEN)))
        lines.append(line)
    return table(["method", *(f"action {action}" for action in actions)], lines)


def by_garment(rows: Sequence[Row]) -> str:
    """Return errors per garment, because two layers are a different task than one."""
    kinds = sorted({str(row["kind"]) for row in rows})
    lines = []
    for variant in dict.fromkeys(str(row["variant"]) for row in rows):
        line = [variant]
        for kind in kinds:
            chosen = [r for r in rows if (r["variant"], r["kind"]) == (variant, kind)]
            line.append(" / ".join(each.cells(chosen)[0] for each in (_ALL, VISIBLE, HIDDEN)))
        lines.append(line)
    return table(["method", *kinds], lines)


_ALL = Column("all", "error_all_mm")


def _groups(variants: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Return groups of variants: those called axis=value by axis, the others together."""
    groups: dict[str, list[str]] = {}
    for variant in variants:
        groups.setdefault(variant.partition("=")[0] if "=" in variant else "", []).append(variant)
    return [(f"### {axis}" if axis else "", names) for axis, names in groups.items()]
