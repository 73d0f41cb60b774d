"""One column of a table: its measure, rows and format."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from shared.bench_measures import Row


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        last: only the last action of each recording, as the paper measures.
    """

    title: str
    key: str
    scale: float = 1.0
    digits: int = 1
    stage: str = "after"
    last: bool = False
    spread: bool = False

    def values(self, rows: Iterable[Row]) -> dict[object, float]:
        """Return the mean over the actions of each recording; unknown values are left out."""
        of: dict[object, list[float]] = {}
        for row in rows:
            value = row.get(self.key)
            if row.get("stage") != self.stage or value is None:
                continue
            if self.last and row["action"] != row["actions"]:
                continue
            of.setdefault(row["recording"], []).append(self.scale * float(value))
        return {name: float(np.mean(each)) for name, each in of.items()}

    def cells(self, rows: Iterable[Row]) -> list[str]:
        """Return the cells for one line: mean, and with spread also deviation and median."""
        values = np.array(list(self.values(rows).values()))
        if not len(values):
            return ["-"] * (2 if self.spread else 1)
        mean = f"{values.mean():.{self.digits}f}"
        if not self.spread:
            return [mean]
        deviation = "-" if len(values) < 2 else f"{values.std(ddof=1):.{self.digits}f}"
        return [f"{mean} ± {deviation}", f"{np.median(values):.{self.digits}f}"]

    @property
    def titles(self) -> list[str]:
        """Headings of the cells."""
        return [self.title, "median"] if self.spread else [self.title]


def table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table."""
    rule = ["---", *("---:" for _ in head[1:])]
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, rule, *lines))


def paired(gaps: np.ndarray, digits: int = 1) -> list[str]:
    """Return mean and standard error of differences, and how many are negative."""
    return [mean_and_error(gaps, digits, "+"), f"{int((gaps < 0).sum())} of {len(gaps)}"]


def mean_and_error(values: np.ndarray, digits: int = 1, sign: str = "") -> str:
    """Return the mean and its standard error."""
    error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
    spread = f"{error:.{digits}f}" if np.isfinite(error) else "-"
    return f"{values.mean():{sign}.{digits}f} ± {spread}"
