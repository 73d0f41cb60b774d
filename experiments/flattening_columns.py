"""The columns of the flattening table, its curve over actions, and what the targets ask."""

from collections.abc import Mapping, Sequence

import numpy as np
from bench_measures import Row
from table_column import Column, table

IMPROVEMENT = Column("normalised improvement", "improvement", digits=3, last=True, spread=True)
FLATTENING_COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "flattening": (
        IMPROVEMENT,
        Column("coverage at the start %", "start_share", 100, 0, last=True),
        Column("at the end %", "share", 100, 0, last=True),
        Column("actions used", "used", digits=1, last=True),
        Column("grasps missed %", "missed", 100, 0),
        Column("expected gain, cm2", "expected_m2", 1e4, 1),
        Column("true gain, cm2", "gain_m2", 1e4, 1),
        Column("perception CPU s", "perception_cpu_s", digits=1),
        Column("decision CPU s", "decision_cpu_s", digits=1),
    )
}
FLATTENING_TITLES = {"flattening": "Flattening: ten pick-and-places from the same crumpled starts"}
FLATTENING_PAIRED = {"flattening": (IMPROVEMENT,)}

PRETRAINED, TUNED, BOUND = "pretrained", "fine-tuned", "control: truth, simulator"


def curve(rows: Sequence[Row], variants: Sequence[str]) -> str:
    """Mean normalised improvement after each action; an episode that ended stays where it was."""
    actions = sorted({int(row["action"]) for row in rows})
    lines = []
    for variant in variants:
        line = [variant]
        for action in actions:
            chosen = [
                float(row["improvement"])
                for row in rows
                if (row["variant"], row["action"]) == (variant, action)
            ]
            line.append(f"{np.mean(chosen):.3f}" if chosen else "-")
        lines.append(line)
    return table(["method", *map(str, actions)], lines)


def targets(rows: Sequence[Row]) -> str:
    """The fine-tuned network against the pretrained one and the upper bound, on shared starts."""
    values = {
        name: IMPROVEMENT.values(row for row in rows if row["variant"] == name)
        for name in (PRETRAINED, TUNED, BOUND)
    }
    told = []
    for ours, theirs, words, target in (
        (TUNED, PRETRAINED, "fine-tuned over pretrained", "1.30 or more (paper: 0.30 / 0.23)"),
        (TUNED, BOUND, "fine-tuned over the upper bound", "0.80 or more"),
    ):
        both = [name for name in values[ours] if name in values[theirs]]
        below = float(np.mean([values[theirs][name] for name in both])) if both else 0.0
        if below > 0.0:
            above = float(np.mean([values[ours][name] for name in both]))
            told.append(f"- {words}: {above / below:.2f} (target: {target})")
    if values[TUNED]:
        mean = float(np.mean(list(values[TUNED].values())))
        told.append(f"- fine-tuned: {mean:.3f} (target: 0.45 or more)")
    return "\n".join(told)
