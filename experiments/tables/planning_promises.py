"""What plans promise and what comes of them, by how far off the cloth they are placed.

Every action that the episodes of `flattening.py` planned: the gain that was promised, the true
gain, and the distance from the place to the nearest cloth. A least-squares fit tells what a metre
farther off is worth beside the promise; over the promise's own slope it is the width of a strip
(`planner.strip_m`). What was planned with a strip is left out: the strip was chosen from the rest.

    python experiments planning_promises --out OUT --kind tshirt

OUT is that of `flattening.py`. Random actions promise nothing; they are fitted without.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from scipy.spatial import cKDTree
from shared.figures import say

from clothtrack.errors import ClothTrackError
from clothtrack.geometry import projected_area
from tables.planning_dynamics import Done, episodes

BINS_M = (0.0, 0.02, 0.05, 0.10, np.inf)
MOST_PROMISE_CM2 = 150.0
"""A larger promise is counted as this one, or a handful of them would decide the slope."""

GROUPS = {"network": "planned, a network's mesh", "truth": "planned, *the truth*", "none": "random"}


def table(done: Sequence[Done]) -> np.ndarray:
    """Promise [cm2], true gain [cm2] and distance off the cloth [m] of each action."""
    rows = []
    for one in done:
        off = float(cKDTree(one.before[:, :2]).query(one.action.place[:2])[0])
        gain = projected_area(one.after, one.flat.faces) - projected_area(
            one.before, one.flat.faces
        )
        rows.append((min(1e4 * one.promised_m2, MOST_PROMISE_CM2), 1e4 * gain, off))
    return np.array(rows)


def fitted(rows: np.ndarray) -> Mapping[str, tuple[float, float]]:
    """Least squares of the true gain [cm2]: coefficients with their standard errors, by name."""
    promise, gain, off = rows.T
    columns = {"constant": np.ones(len(rows)), "promise": promise, "off": off}
    if np.ptp(promise) == 0.0:
        del columns["promise"]
    inputs = np.stack(list(columns.values()), axis=1)
    found = np.linalg.lstsq(inputs, gain, rcond=None)[0]
    left = gain - inputs @ found
    variance = left @ left / max(len(rows) - inputs.shape[1], 1)
    errors = np.sqrt(variance * np.diag(np.linalg.pinv(inputs.T @ inputs)))
    return dict(zip(columns, zip(found.tolist(), errors.tolist(), strict=True), strict=True))


def markdown(groups: Mapping[str, np.ndarray]) -> str:
    """Both tables."""
    lines = ["| | place off the cloth, cm | actions | promised, cm2 | true gain, cm2 |",
             "|---|---|---:|---:|---:|"]  # fmt: skip
    for name, rows in groups.items():
        for low, high in pairwise(BINS_M):
            chosen = rows[(rows[:, 2] >= low) & (rows[:, 2] < high)]
            if not len(chosen):
                continue
            reach = f"{100 * low:.0f} to {100 * high:.0f}" if np.isfinite(high) else (
                f"over {100 * low:.0f}"
            )  # fmt: skip
            error = chosen[:, 1].std() / np.sqrt(len(chosen))
            promised = f"{chosen[:, 0].mean():.0f}" if np.ptp(rows[:, 0]) else "-"
            lines.append(
                f"| {name} | {reach} | {len(chosen)} | {promised} | "
                f"{chosen[:, 1].mean():.0f} ± {error:.0f} |"
            )
    lines += ["", "| | per promised cm2 | per metre off the cloth, cm2 | strip, m |",
              "|---|---:|---:|---:|"]  # fmt: skip
    for name, rows in groups.items():
        found = fitted(rows)
        slope, off = found.get("promise"), found["off"]
        kept = "-" if slope is None else f"{slope[0]:.2f} ± {slope[1]:.2f}"
        strip = "-" if slope is None else f"{off[0] / slope[0] / 1e4:.3f}"
        lines.append(f"| {name} | {kept} | {off[0]:.0f} ± {off[1]:.0f} | {strip} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the episodes")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    options = parser.parse_args(arguments)
    try:
        everything = [
            one for done in episodes(options.out, options.kind).values() for one in done
            if one.policy == "random" or (one.policy == "planned" and one.strip_m == 0.0)
        ]  # fmt: skip
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    groups = {
        name: table([one for one in everything if one.perception == perception])
        for perception, name in GROUPS.items()
        if any(one.perception == perception for one in everything)
    }
    if not groups:
        sys.stderr.write(f"{options.out}: every plan there was made with a strip\n")
        return 1
    say(f"{__doc__.splitlines()[0]}\n\n{markdown(groups)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
