"""The targets of the benchmark, each met or missed, from the rows of table1.py.

    python experiments targets --rows OUT/experiments

They are stated for the `test` split; whatever split the rows are of is said. A missing method or
action leaves its targets out.
"""

import argparse
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row
from shared.bench_runs import read_rows
from shared.figures import say
from shared.paper_numbers import PAPER
from shared.tables import CHAMFER_LAST, ERROR, HIDDEN, Column, about, table

OURS, PAPERS = "default", "paper"


@dataclass(frozen=True)
class Target:
    """One target and what was measured.

    Attributes:
        name: what is asked.
        limit: the most that is allowed.
        value: what was measured; NaN when the rows do not say.
        digits: after the point.
    """

    name: str
    limit: float
    value: float
    digits: int = 1

    @property
    def verdict(self) -> str:
        """Met, missed, or not measured."""
        if not math.isfinite(self.value):
            return "not measured"
        return "met" if self.value <= self.limit else "missed"


def targets(rows: Iterable[Row]) -> list[Target]:
    """Return all targets that the rows of Table 1 can judge."""
    good = [row for row in rows if "error" not in row]
    ours = [row for row in good if row["variant"] == OURS]
    papers = [row for row in good if row["variant"] == PAPERS]
    after = [row for row in ours if row["stage"] == "after"]
    before = [row for row in ours if row["stage"] == "before"]
    error = _mean(ERROR, ours)
    # The paper's mode may have been run on fewer recordings: a share is one of the same ones.
    shared = {row["recording"] for row in papers}
    beside = _mean(ERROR, [row for row in ours if row["recording"] in shared])
    first, third = (_mean(ERROR, [r for r in ours if r["action"] == each]) for each in (1, 3))
    over = [
        row
        for row in after
        if row["crossings_per_1000_edges"] > 2.0 * row["world_crossings_per_1000_edges"]
    ]
    chamfer, floor = (
        sum(float(row[key]) for row in before if row[key] is not None)
        for key in ("chamfer_pc_m2", "chamfer_floor_m2")
    )
    return [
        Target("mean vertex error [mm]", 4.5, error),
        Target("third action [mm]", 5.5, third),
        Target("share of the paper's mode [%]", 60.0, _ratio(100 * beside, _mean(ERROR, papers))),
        Target("hidden vertices [mm]", 5.0, _mean(HIDDEN, ours)),
        Target("third action / first action", 1.8, _ratio(third, first), 2),
        Target("crossings per 1,000 edges", 1.0, _mean(_RATE, ours), 2),
        Target(
            "meshes with over twice the world's crossings", 9, len(over) if after else np.nan, 0
        ),
        Target("Chamfer before TTO2 / its floor", 2.0, _ratio(chamfer, floor), 2),
        Target("trajectories that failed", 0, _failed(rows), 0),
    ]


_RATE = Column("", "crossings_per_1000_edges")


def order(rows: Sequence[Row]) -> tuple[list[str], list[str]]:
    """Table 1's methods from the lowest Chamfer distance up: the paper's order, and ours."""
    ours = {}
    for name in PAPER["table1"]:
        value = _mean(CHAMFER_LAST, [row for row in rows if row.get("variant") == name])
        if math.isfinite(value):
            ours[name] = value
    papers = {name: PAPER["table1"][name] for name in ours}
    return sorted(papers, key=papers.__getitem__), sorted(ours, key=ours.__getitem__)


def _failed(rows: Iterable[Row]) -> int:
    return len({row["recording"] for row in rows if "error" in row and row["variant"] == OURS})


def _mean(column: Column, rows: Sequence[Row]) -> float:
    values = list(column.values(rows).values())
    return float(np.mean(values)) if values else math.nan


def _ratio(above: float, below: float) -> float:
    return above / below if below > 0 else math.nan


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the targets; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=Path, required=True, help="folder of the rows")
    options = parser.parse_args(arguments)
    file = options.rows / "table1.jsonl"
    if not file.exists():
        say(f"no rows of table1 in {options.rows}: run table1.py\n")
        return 1
    rows = read_rows(file)
    lines = [
        [one.name, f"{one.limit:g}", f"{one.value:.{one.digits}f}", one.verdict]
        for one in targets(rows)
    ]
    papers, ours = order(rows)
    say(f"{about([row for row in rows if 'error' not in row])}\n\n")
    say(f"{table(['target', 'at most', 'measured', ''], lines)}\n\n")
    word = "reproduced" if papers == ours else "not reproduced"
    word = word if papers else "not measured, there are no rows of the paper's modes"
    say(f"Order of Table 1 by Chamfer: {word}.\npaper: {' < '.join(papers)}\n")
    say(f"ours:  {' < '.join(ours)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
