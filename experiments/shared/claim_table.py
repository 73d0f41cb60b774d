"""The tables of the claim: errors after learning, and their differences on the same recordings."""

from collections.abc import Mapping, Sequence

import numpy as np

from shared.bench_measures import Row
from shared.table_column import table

ERROR = "error_symmetric_mm"
BEFORE = "before"
PAIRED_WITH = ("before", "open_loop", "truth")
GROUP = "garment", "network", "recordings", "held_out"
HEAD = (
    "learned from", "labels wrong by, mm", "trainings", "error mm", "over before", "visible",
    "hidden", "Chamfer PC", *(f"minus {name}" for name in PAIRED_WITH), "no mesh %",
)  # fmt: skip

Values = Mapping[tuple[str, int], float]
"""A measure by recording and seed: the mean of the recording's pictures."""


def markdown(rows: Sequence[Row]) -> str:
    """Return one table for each garment and network."""
    parts = []
    for group in dict.fromkeys(tuple(row[key] for key in GROUP) for row in rows):
        own = [row for row in rows if tuple(row[key] for key in GROUP) == group]
        good = [row for row in own if "error" not in row]
        garment, network, recordings, held_out = group
        parts.append(
            f"## {garment}, {network} network: {recordings} recordings to learn from, {held_out} "
            "held out"
        )
        parts.append(of_one(good))
        parts += [
            f"- failed: {row['variant']}, {row['recording']}: {row['error']}"
            for row in own
            if "error" in row
        ]
    return "\n\n".join(parts or ["Nothing is finished."]) + "\n"


def of_one(rows: Sequence[Row]) -> str:
    """Return one line for each kind of label."""
    names = list(dict.fromkeys(str(row["variant"]) for row in rows))
    by_name = {name: [row for row in rows if row["variant"] == name] for name in names}
    errors = {name: values(own, ERROR) for name, own in by_name.items()}
    return table(HEAD, [_line(name, by_name[name], errors) for name in names])


def _line(name: str, rows: Sequence[Row], errors: Mapping[str, Values]) -> list[str]:
    own, label = errors[name], rows[0]["label_error_mm"]
    before = _paired(own, BEFORE, errors)
    below = float(np.mean([own[key] - gap for key, gap in before.items()])) if before else np.nan
    rate = float(np.mean([own[key] for key in before])) / below if before else np.nan
    return [
        name,
        "-" if label is None else f"{label:.1f}",
        str(len({seed for _, seed in own})),
        f"{np.mean(list(own.values())):.1f} ± {standard_error(own):.1f}" if own else "-",
        f"{rate:.2f}" if np.isfinite(rate) else "-",
        _mean(rows, "error_symmetric_visible_mm", 1.0, 1),
        _mean(rows, "error_symmetric_hidden_mm", 1.0, 1),
        _mean(rows, "chamfer_pc_m2", 1e4, 2),
        *(_difference(own, other, errors) if other != name else "-"
          for other in PAIRED_WITH),
        f"{100.0 * np.mean([not row['has_mesh'] for row in rows]):.0f}",
    ]  # fmt: skip


def values(rows: Sequence[Row], key: str) -> Values:
    """Return the mean of each recording's pictures, by recording and seed."""
    found: dict[tuple[str, int], list[float]] = {}
    for row in rows:
        if row.get(key) is not None:
            found.setdefault((row["recording"], row["seed"]), []).append(float(row[key]))
    return {name: float(np.mean(each)) for name, each in found.items()}


def standard_error(of: Values) -> float:
    """Return the standard error of the mean, including the variance over recordings and seeds.

    The root of the sum of the squared standard errors of the recordings' means and of the seeds'.
    With one seed it is that of the recordings alone.
    """
    total = 0.0
    for place in (0, 1):
        groups: dict[object, list[float]] = {}
        for key, value in of.items():
            groups.setdefault(key[place], []).append(value)
        means = [float(np.mean(each)) for each in groups.values()]
        if len(means) > 1:
            total += float(np.var(means, ddof=1)) / len(means)
    return total**0.5


def _paired(own: Values, name: str, errors: Mapping[str, Values]) -> Values:
    """Return differences from another kind of label, by recording and seed.

    An untrained network has one value for all seeds.
    """
    other = errors.get(name, {})
    if name == BEFORE:
        first = {recording: value for (recording, _), value in other.items()}
        other = {key: first[key[0]] for key in own if key[0] in first}
    return {key: value - other[key] for key, value in own.items() if key in other}


def _difference(own: Values, name: str, errors: Mapping[str, Values]) -> str:
    gaps = _paired(own, name, errors)
    if not gaps:
        return "-"
    lower = sum(gap < 0 for gap in gaps.values())
    mean = np.mean(list(gaps.values()))
    return f"{mean:+.1f} ± {standard_error(gaps):.1f} ({lower} of {len(gaps)})"


def _mean(rows: Sequence[Row], key: str, scale: float, digits: int) -> str:
    found = [scale * float(row[key]) for row in rows if row.get(key) is not None]
    return f"{np.mean(found):.{digits}f}" if found else "-"
