"""Draw flattening in one picture: curves over actions per method, and three episodes of one.

    python experiments flattening_figure --out OUT --image docs/images/flattening.png

OUT is that of `flattening.py`. The episodes are the best, the median and the worst of `--method` by
final score, not by appearance; the same starts of other methods are not searched.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import cv2
import numpy as np
from jaxtyping import UInt8
from shared.bench_measures import Row
from shared.bench_runs import read_rows
from shared.figures import plot_style, say
from shared.flattening_columns import BOUND, IMPROVEMENT, PRETRAINED, TUNED, curve_values

from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidResultError
from clothtrack.report.palette import INK

Picture = UInt8[np.ndarray, "height width 3"]

TILE = (320, 264)
"""Width and height of one picture of a strip [pixels]."""

SHOWN = 6
"""Most pictures of an episode in the figure."""

NAME = "flattening"


def chosen_episodes(rows: Sequence[Row], method: str) -> Mapping[str, str]:
    """Return the best, the median and the worst episode of a method, by where they ended."""
    ended = IMPROVEMENT.values(row for row in rows if row["variant"] == method)
    order = sorted(ended, key=lambda name: (ended[name], str(name)))
    if not order:
        raise InvalidConfigError(f"there are no rows of {method!r}; name another --method")
    picked = {"best": order[-1], "median": order[(len(order) - 1) // 2], "worst": order[0]}
    return {which: str(name) for which, name in picked.items()}


def episode_line(strip: Picture, used: int, most: int = SHOWN) -> Picture:
    """Return pictures of a strip beside each other: the first, the last, and some between."""
    width, height = TILE
    columns = strip.shape[1] // width
    tiles = [
        strip[height * (n // columns) :, width * (n % columns) :][:height, :width]
        for n in range(used + 1)
    ]
    picked = np.unique(np.linspace(0, used, min(most, used + 1)).round().astype(int))
    blank = np.full((height, width, 3), 255, np.uint8)
    return np.hstack([*(tiles[n] for n in picked), *[blank] * (most - len(picked))])


def strip_of(out: Path, rows: Sequence[Row], method: str, recording: str) -> Picture:
    """Return the line of one episode."""
    row = next(row for row in rows if (row["variant"], row["recording"]) == (method, recording))
    path = out / NAME / row["provenance"]["config_hash"] / "strips" / f"{recording}.png"
    read = cv2.imread(str(path))
    if read is None:
        raise InvalidResultError(f"{path}: no strip of the episode; run flattening.py again")
    return episode_line(cv2.cvtColor(read, cv2.COLOR_BGR2RGB), int(row["used"]))


def draw(out: Path, rows: Sequence[Row], method: str, image: Path) -> Path:
    """Return the figure as a PNG."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    chosen = chosen_episodes(rows, method)
    with plt.rc_context(plot_style(title_size=9)):
        figure, axes = plt.subplots(
            1 + len(chosen), 1, figsize=(11.0, 9.5), layout="constrained",
            height_ratios=[2.2, *[1.0] * len(chosen)],
        )  # fmt: skip
        _curve_panel(axes[0], rows)
        for axis, (which, name) in zip(axes[1:], chosen.items(), strict=True):
            axis.imshow(strip_of(out, rows, method, name))
            axis.set_axis_off()
            axis.set_title(f"{which}: {method}, {name}")
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
    parser.add_argument("--method", default="", help="whose episodes are shown")
    options = parser.parse_args(arguments)
    try:
        rows = [
            row for row in read_rows(options.out / f"{NAME}.jsonl")
            if "error" not in row and row["kind"] == options.kind
        ]  # fmt: skip
        known = {str(row["variant"]) for row in rows}
        usual = [name for name in (TUNED, PRETRAINED, BOUND) if name in known]
        say(str(draw(options.out, rows, options.method or (*usual, "random")[0], options.image)))
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
