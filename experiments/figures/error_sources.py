"""Draw the sources of error in one figure: calibration, layers, hidden parts and drift.

    python experiments error_sources --rows OUT/experiments --image docs/images/error_sources.png

There are four panels; a panel whose rows are missing names the experiment that makes them.

- Drift: how the default's error grows from action to action, and how much of it is the cloth as a
  whole in the wrong place (what the best rigid motion takes away).
- Layers and hidden parts: what vertices whose layers are in the wrong order contribute to the mean
  error, and of the others the visible and the hidden ones; by garment.
- Shape or place: the same for every method: slip of the whole, and what is left.
- Causes: by how much the error falls when one cause is taken away, paired by recording: another
  first mesh, a camera without noise, true friction, true thickness.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row
from shared.bench_runs import read_rows
from shared.figures import plot_style, say
from shared.tables import Column, differences

from clothtrack.report.palette import HIDDEN, INK, INSIDE, OBSERVED, OUTSIDE

ERROR = Column("error", "error_all_mm")
KINDS = {"towel": "towel", "tshirt": "T-shirt"}
GROUPS = {"visible": OUTSIDE, "hidden": HIDDEN, "swapped": INSIDE}
METHOD_NAMES = {
    "paper": "paper",
    "no_pseudo_action": "no pseudo-action",
    "no_dynamics_initialization": "no dyn. init",
    "no_action_conditioning": "no action",
    "no_final_alignment": "no TTO2",
    "open_loop": "open loop",
    "drift and edge lengths": "model-free",
}
CAUSES = (
    ("exact first mesh", "sensitivity", "first mesh=0", "first mesh=1"),
    ("camera without noise", "sensitivity", "noise=0", "noise=1"),
    ("denser cloud (2 mm)", "sensitivity", "cloud=2 mm", "cloud=4 mm"),
    ("finer mesh (4,000)", "sensitivity", "vertices=4000", "vertices=2000"),
    ("true friction", "calibration", "default, true friction", "default, online"),
    ("true thickness", "calibration", "default, true thickness", "default, online"),
    ("any calibration", "calibration", "default, online", "default, uncalibrated"),
)
"""Label, experiment, the variant without the cause, and the one with it."""


def rows_by_experiment(folder: Path) -> dict[str, list[Row]]:
    """Return the good rows of every experiment in a folder."""
    return {
        file.stem: [row for row in read_rows(file) if "error" not in row]
        for file in sorted(folder.glob("*.jsonl"))
    }


def drift(rows: dict[str, list[Row]]) -> tuple[list[int], dict[str, list[float]]]:
    """Actions, and the default's mean errors [mm] at each: all, hidden, and without slip."""
    six = _of(rows, "sensitivity", "actions=")
    chosen = six or _of(rows, "table1", "default") or _of(rows, "model_free", "default")
    actions = sorted({int(row["action"]) for row in chosen})
    keys = {
        "visible": "error_visible_mm",
        "hidden": "error_hidden_mm",
        "all": "error_all_mm",
        "all, the whole put right": "error_without_slip_mm",
    }
    lines = {
        label: [_mean(row[key] for row in chosen if row["action"] == each) for each in actions]
        for label, key in keys.items()
    }
    return actions, lines


def contributions(rows: dict[str, list[Row]]) -> list[tuple[str, float, float, float]]:
    """Return, per garment and action, three vertex groups' contributions to the mean error [mm].

    The groups are the visible and the hidden ones whose layers are in order, and the swapped ones.
    """
    chosen = _of(rows, "table1", "default") or _of(rows, "model_free", "default")
    bars = []
    for kind, label in KINDS.items():
        for action in sorted({int(row["action"]) for row in chosen}):
            own = [r for r in chosen if (r["kind"], r["action"]) == (kind, action)]
            if own:
                parts = [_mean(row.get(f"part_{group}_mm") for row in own) for group in GROUPS]
                bars.append((f"{label} {action}", *parts))
    return bars


def shape_or_place(rows: dict[str, list[Row]]) -> list[tuple[str, float, float]]:
    """Return, per method, the error removed by one rigid motion, and the rest [mm]."""
    bars = []
    for experiment in ("table1", "model_free"):
        own = rows.get(experiment, [])
        for name in dict.fromkeys(str(row["variant"]) for row in own):
            label = METHOD_NAMES.get(name, name)
            if label in {bar[0] for bar in bars} or name.startswith("the same"):
                continue
            chosen = _of(rows, experiment, name)
            rest = _mean(row["error_without_slip_mm"] for row in chosen)
            # The least squares motion need not lessen a mean of distances.
            slip = max(0.0, _mean(row["error_all_mm"] for row in chosen) - rest)
            bars.append((label, slip, rest))
    return bars


def causes(rows: dict[str, list[Row]]) -> list[tuple[str, float, float, int]]:
    """Return, per cause, the mean error reduction without it [mm], standard error and number."""
    bars = []
    for label, experiment, without, with_it in CAUSES:
        gaps = -differences(rows.get(experiment, []), without, with_it, ERROR)
        if len(gaps):
            spread = gaps.std(ddof=1) / np.sqrt(len(gaps)) if len(gaps) > 1 else np.nan
            bars.append((label, float(gaps.mean()), float(spread), len(gaps)))
    return bars


def _of(rows: dict[str, list[Row]], experiment: str, variant: str) -> list[Row]:
    """Return the rows after TTO2 of a variant, or of all that start with it if it ends in "="."""
    return [
        row
        for row in rows.get(experiment, [])
        if row["stage"] == "after"
        and (
            row["variant"] == variant
            or (variant.endswith("=") and str(row["variant"]).startswith(variant))
        )
    ]


def _mean(values: Any) -> float:
    known = [float(value) for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")


def draw(rows: dict[str, list[Row]], image: Path) -> Path:
    """Draw the four panels."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(plot_style(title_size=10)):
        figure, axes = plt.subplots(2, 2, figsize=(11.0, 7.5), layout="constrained")
        panels: Sequence[tuple[Any, Callable[..., bool], str]] = (
            (axes[0, 0], _drift_panel, "table1.py or sensitivity.py --axes actions"),
            (axes[0, 1], _hidden_panel, "table1.py"),
            (axes[1, 0], _place_panel, "table1.py"),
            (axes[1, 1], _cause_panel, "sensitivity.py and calibration.py"),
        )
        for axis, panel, maker in panels:
            if not panel(axis, rows):
                axis.text(0.5, 0.5, f"no rows yet: run {maker}", ha="center", va="center")
                axis.set_axis_off()
        image.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(image, dpi=110)
        plt.close(figure)
    return image


def _drift_panel(axis: Any, rows: dict[str, list[Row]]) -> bool:
    actions, lines = drift(rows)
    if not actions:
        return False
    looks = {"visible": (OUTSIDE, "-"), "hidden": (HIDDEN, "-"), "all": (INK, "-")}
    for label, values in lines.items():
        color, dashes = looks.get(label, (INK, ":"))
        axis.plot(actions, values, dashes, color=color, marker="o", markersize=4, label=label)
    axis.set(title="Drift: the default, action by action", xlabel="action", ylabel="error [mm]")
    axis.set_xticks(actions)
    axis.set_ylim(bottom=0.0)
    axis.legend(frameon=False, fontsize=8)
    return True


def _hidden_panel(axis: Any, rows: dict[str, list[Row]]) -> bool:
    bars = contributions(rows)
    if bars:
        names, *parts = (np.array(each) for each in zip(*bars, strict=True))
        names = [name.replace(" ", "\n") for name in names]
        labels = ("visible vertices", "hidden vertices", "layers in wrong order")
        base = np.zeros(len(names))
        for part, label, color in zip(parts, labels, GROUPS.values(), strict=True):
            axis.bar(names, part, 0.6, bottom=base, color=color, label=label)
            base = base + part
        axis.set_ylim(top=1.45 * np.nanmax(base))
        axis.set(title="Layers and hidden parts: who makes the mean", ylabel="error [mm]")
        axis.set_xlabel("garment and action")
        axis.legend(frameon=False, loc="upper left", fontsize=8)
    return bool(bars)


def _place_panel(axis: Any, rows: dict[str, list[Row]]) -> bool:
    bars = shape_or_place(rows)[::-1]
    if bars:
        names, slip, rest = zip(*bars, strict=True)
        axis.barh(names, rest, color=INSIDE, label="shape: left after a rigid motion")
        axis.barh(names, slip, left=rest, color=OBSERVED, label="place: slip of the whole cloth")
        axis.set(title="Shape or place: every method", xlabel="error [mm]")
        axis.margins(y=0.12)
        axis.set_ylim(top=len(bars) + 1.1)
        axis.legend(frameon=False, loc="upper right", fontsize=8)
    return bool(bars)


def _cause_panel(axis: Any, rows: dict[str, list[Row]]) -> bool:
    bars = causes(rows)[::-1]
    if bars:
        names, falls, spreads, counts = zip(*bars, strict=True)
        labels = [f"{name} (n={count})" for name, count in zip(names, counts, strict=True)]
        axis.barh(labels, falls, xerr=np.nan_to_num(spreads), color=OUTSIDE, ecolor=INK, capsize=3)
        axis.axvline(0.0, color=INK, linewidth=0.8)
        axis.set(title="Causes: what each would save", xlabel="fall of the error [mm], paired")
    return bool(bars)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the figure and print its numbers; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--image", type=Path, default=Path("docs/images/error_sources.png"))
    options = parser.parse_args(arguments)
    rows = rows_by_experiment(options.rows)
    if not any(rows.values()):
        say(f"no rows in {options.rows}\n")
        return 1
    actions, lines = drift(rows)
    for label, values in lines.items():
        each = ", ".join(f"{a}: {v:.1f}" for a, v in zip(actions, values, strict=True))
        say(f"error by action [mm], {label}: {each}\n")
    for label, fall, spread, count in causes(rows):
        say(f"{label}: {fall:+.2f} ± {spread:.2f} mm less (n={count})\n")
    say(f"{draw(rows, options.image)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
