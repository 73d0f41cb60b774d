"""Draw the benefit of more training: error on the same fresh states over examples seen.

    python experiments network_on_states --states DIR... --weights W1 W2 W3 --json ROWS --refined
    python experiments learning_curve --rows ROWS --examples 184000 314416 341280 --image FILE

W1, W2, ... are weights of one training, earliest first; --examples gives how many each has seen.
For every kind of garment, by coverage, the table has the mean error and the prediction of a fitted
power law: the error after 100,000 and a million more examples, and the factor on the number of
examples for half the error. A fit to a few weights does not show how far it can be extrapolated.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from jaxtyping import Float
from shared.figures import plot_style, say
from shared.tables import table
from tables.network_on_states import HEAP

MORE = (100_000, 1_000_000)
"""Examples more, for which the fit is asked."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Errors of one kind of state against the examples that were seen.

    Attributes:
        examples: that each of the weights had seen.
        errors_mm: mean error of each [mm].
    """

    name: str
    states: int
    examples: Float[np.ndarray, " weights"]
    errors_mm: Float[np.ndarray, " weights"]
    spreads_mm: Float[np.ndarray, " weights"]

    def after(self, more: float) -> float:
        """Return the error [mm] of the fitted power law after `more` further examples."""
        slope, offset = self._fit()
        return float(np.exp(offset + slope * np.log(self.examples[-1] + more)))

    @property
    def halving(self) -> float:
        """Factor on the number of examples for half the error, by the fit; infinite if it rises."""
        slope, _ = self._fit()
        return float(2.0 ** (-1.0 / slope)) if slope < 0.0 else float("inf")

    def _fit(self) -> tuple[float, float]:
        slope, offset = np.polyfit(np.log(self.examples), np.log(self.errors_mm), 1)
        return float(slope), float(offset)


def curves(rows: Sequence[dict[str, Any]], examples: Sequence[int]) -> list[Curve]:
    """Return the curve of each kind, of all its states and of its heaps."""
    networks = list(dict.fromkeys(row["weights"] for row in rows))
    if len(networks) != len(examples) or len(networks) < 2:
        raise ValueError(
            f"--examples has {len(examples)} numbers for {len(networks)} networks in the rows; "
            "give one each, of two networks or more"
        )
    found = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        for words, most in (("all", np.inf), (f"below {100 * HEAP:g} %", HEAP)):
            errors = [
                [row["error_mm"] for row in rows if row["weights"] == network
                 and row["kind"] == kind and "error_mm" in row and row["coverage"] < most]
                for network in networks
            ]  # fmt: skip
            if min(map(len, errors)) > 1:
                found.append(
                    Curve(
                        f"{kind}, {words}",
                        len(errors[-1]),
                        np.array(examples, float),
                        np.array([np.mean(one) for one in errors]),
                        np.array([np.std(one, ddof=1) / len(one) ** 0.5 for one in errors]),
                    )
                )
    return found


def markdown(found: Sequence[Curve]) -> str:
    """Return one line per curve: the errors [mm], and what the fit says of more examples."""
    seen = [f"{one / 1000:.0f}k" for one in found[0].examples]
    head = ["error, mm", "states", *seen, *(f"fit: {one / 1000:,.0f}k more" for one in MORE),
            "half the error: times as many"]  # fmt: skip
    lines = [
        [one.name, str(one.states), *(f"{error:.1f}" for error in one.errors_mm),
         *(f"{one.after(more):.0f}" for more in MORE), f"{one.halving:.0f}"]
        for one in found
    ]  # fmt: skip
    return table(head, lines)


def draw(found: Sequence[Curve], image: Path) -> None:
    """Draw all states in one panel and the heaps in another."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    with plt.rc_context(plot_style(title_size=10)):
        figure, panels = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained", sharey=True)
        for panel, words in zip(panels, ("all", f"below {100 * HEAP:g} %"), strict=True):
            for one in found:
                kind, _, which = one.name.partition(", ")
                if which == words:
                    panel.errorbar(
                        one.examples / 1000, one.errors_mm, one.spreads_mm, label=kind, capsize=2
                    )
            title = "all fresh states" if words == "all" else f"covering {words} of their area"
            panel.set(title=title, xlabel="examples seen, thousands")
        panels[0].set_ylim(bottom=0.0)
        panels[0].set_ylabel("mean error of a vertex, mm")
        panels[0].legend(frameon=False)
        image.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(image, dpi=120)
        plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and draw the figure; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=Path, required=True, help="JSON of network_on_states")
    parser.add_argument("--examples", type=int, nargs="+", required=True, help="seen by each")
    parser.add_argument("--image", type=Path, help="file of the figure")
    options = parser.parse_args(arguments)
    try:
        rows = json.loads(options.rows.read_text(encoding="utf-8"))["rows"]
        found = curves(rows, options.examples)
    except (OSError, ValueError, LookupError) as error:
        sys.stderr.write(f"{options.rows}: {error}\n")
        return 1
    if options.image is not None:
        draw(found, options.image)
    say(f"{markdown(found)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
