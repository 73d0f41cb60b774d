"""The columns of the flattening table, its curve over actions, and its targets."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import spearmanr

from shared.bench_measures import Row
from shared.table_column import Column, table

IMPROVEMENT = Column("normalized improvement", "improvement", digits=3, last=True, spread=True)
DECISION = Column("decision CPU s", "decision_cpu_s", digits=1)
END_ERROR = Column("error at the end, mm", "end_error_mm", spread=True)
FLATTENING_COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "flattening": (
        IMPROVEMENT,
        Column("coverage at the start %", "start_share", 100, 0, last=True),
        Column("at the end %", "share", 100, 0, last=True),
        Column("actions used", "used", digits=1, last=True),
        Column("grasps missed %", "missed", 100, 0),
        Column("out of the picture at the end %", "out_of_picture", 100, 1, last=True),
        Column("expected gain, cm2", "expected_m2", 1e4, 1),
        Column("true gain, cm2", "gain_m2", 1e4, 1),
        Column("crossings in the world", "world_crossings", digits=1),
        Column("perception CPU s", "perception_cpu_s", digits=1),
        DECISION,
    ),
    "planning_dynamics": (
        END_ERROR,
        Column("had nothing moved, mm", "still_mm"),
        Column("doing nothing moves it by, mm", "rest_error_mm"),
        Column("promised gain, cm2", "promised_m2", 1e4, 1),
        Column("true gain, cm2", "gain_m2", 1e4, 1),
        DECISION,
        Column("rank correlation with the simulator", "agreement", digits=2),
    ),
}  # fmt: skip
FLATTENING_TITLES = {
    "flattening": "Flattening: ten pick-and-places from the same crumpled starts",
    "planning_dynamics": "Dynamics to plan in: what they say of actions that were done (control)",
}
FLATTENING_PAIRED = {
    "flattening": (IMPROVEMENT,),
    "planning_dynamics": (END_ERROR,),
}

PRETRAINED, TUNED, BOUND = "pretrained", "fine-tuned", "control: truth, simulator"


def curve_values(rows: Sequence[Row], variant: str) -> tuple[list[int], list[float]]:
    """Return actions of a method, and the mean normalized improvement after each."""
    of: dict[int, list[float]] = {}
    for row in rows:
        if row["variant"] == variant:
            of.setdefault(int(row["action"]), []).append(float(row["improvement"]))
    actions = sorted(of)
    return actions, [float(np.mean(of[action])) for action in actions]


def curve(rows: Sequence[Row], variants: Sequence[str]) -> str:
    """Return the mean normalized improvement after each action; ended episodes keep their last."""
    actions = sorted({int(row["action"]) for row in rows})
    lines = []
    for variant in variants:
        means = dict(zip(*curve_values(rows, variant), strict=True))
        lines.append([variant, *(f"{means[n]:.3f}" if n in means else "-" for n in actions)])
    return table(["method", *map(str, actions)], lines)


def promises(rows: Sequence[Row], variants: Sequence[str]) -> str:
    """Return how well each dynamics ranks actions by gain, per policy that chose them."""
    policies = list(dict.fromkeys(str(row["policy"]) for row in rows if "policy" in row))
    lines = []
    for variant in variants:
        line = [variant]
        for policy in policies:
            pairs = np.array(
                [(row["promised_m2"], row["gain_m2"]) for row in rows
                 if row["variant"] == variant and row.get("policy") == policy]
            )  # fmt: skip
            known = len(pairs) > 2
            line.append(f"{spearmanr(*pairs.T).statistic:.2f} ({len(pairs)})" if known else "-")
        lines.append(line)
    return table(["dynamics", *policies], lines)


def targets(rows: Sequence[Row]) -> str:
    """Return the fine-tuned network against pretrained one and upper bound, on shared starts."""
    values = {
        name: IMPROVEMENT.values(row for row in rows if row["variant"] == name)
        for name in (PRETRAINED, TUNED, BOUND)
    }
    text = []
    for ours, theirs, words, target in (
        (TUNED, PRETRAINED, "fine-tuned over pretrained", "1.30 or more (paper: 0.30 / 0.23)"),
        (TUNED, BOUND, "fine-tuned over the upper bound", "0.80 or more"),
    ):
        both = [name for name in values[ours] if name in values[theirs]]
        pairs = np.array([(values[ours][name], values[theirs][name]) for name in both])
        if not len(pairs) or pairs[:, 1].mean() <= 0.0:
            continue
        gap = pairs[:, 0] - pairs[:, 1]
        spread = f" ± {gap.std(ddof=1) / np.sqrt(len(gap)):.3f}" if len(gap) > 1 else ""
        text.append(
            f"- {words}: {pairs[:, 0].mean() / pairs[:, 1].mean():.2f} (target: {target}); "
            f"{gap.mean():+.3f}{spread} over {len(gap)} shared starts"
        )
    if values[TUNED]:
        mean = float(np.mean(list(values[TUNED].values())))
        text.append(f"- fine-tuned: {mean:.3f} (target: 0.45 or more)")
    return "\n".join(text)
