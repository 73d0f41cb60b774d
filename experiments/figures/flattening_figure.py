"""Draw the curves of flattening over the actions, one per method.

    python experiments flattening_figure --out OUT --image docs/images/flattening.png

OUT is that of `flattening.py`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import _path  # noqa: F401
from shared.bench_measures import Row
from shared.bench_runs import read_rows
from shared.figures import plot_style, say
from shared.flattening_columns import IMPROVEMENT, curve_values

from clothtrack.errors import ClothTrackError
from clothtrack.report.palette import INK

NAME = "flattening"


def draw(rows: Sequence[Row], image: Path) -> Path:
    """Return the figure of one garment's rows, without failed episodes, as a PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(plot_style(title_size=9)):
        figure, axis = plt.subplots(figsize=(11.0, 4.0), layout="constrained")
        _curve_panel(axis, rows)
        image.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(image, dpi=110)
        plt.close(figure)
    return image


def _curve_panel(axis: Any, rows: Sequence[Row]) -> None:
    variants = list(dict.fromkeys(str(row["variant"]) for row in rows))
    for variant in variants:
        actions, means = curve_values(rows, variant)
        ended = IMPROVEMENT.values(row for row in rows if row["variant"] == variant)
        axis.plot(
            [0, *actions], [0.0, *means], "--" if variant.startswith("control") else "-",
            marker="o", markersize=3, label=f"{variant} ({len(ended)})",
        )  # fmt: skip
    axis.axhline(0.0, color=INK, linewidth=0.5)
    axis.set(
        title="Mean normalized improvement after each action (number of episodes)",
        xlabel="action", ylabel="normalized improvement",
    )  # fmt: skip
    axis.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the figure; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of flattening.py")
    parser.add_argument("--image", type=Path, required=True, help="PNG to write")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    options = parser.parse_args(arguments)
    try:
        rows = [
            row for row in read_rows(options.out / f"{NAME}.jsonl")
            if "error" not in row and row["kind"] == options.kind
        ]  # fmt: skip
        say(str(draw(rows, options.image)))
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
