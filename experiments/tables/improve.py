"""Getting better by doing: flatten, track what was done, label, fine-tune, and flatten again.

Each round flattens from the same starts, tracks its own recordings (backwards, from the flattest
picture), labels them, and fine-tunes on the labels that are expected to be better than the network.
`OUT/improvement.json` is the curve. The same command goes on where an interrupted one stopped. One
round over five shirts gained nothing (docs/notebook/flattening.md).

    python experiments improve WEIGHTS --out OUT --garment tshirt --garment-seed 1 --rounds 2
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import _path  # noqa: F401
from shared.figures import say

from clothtrack.errors import ClothTrackError
from clothtrack.files.settings import with_settings


def in_words(row: Mapping[str, Any]) -> str:
    """Return a round in a line."""
    text = (
        f"round {row['round']}   improvement {row['mean']:.3f} +- {row['deviation']:.3f} over "
        f"{row['episodes']} episodes   {row['weights']}"
    )
    if "labels" in row:
        text += f"   learned from {row['labels']['used']} of {row['labels']['made']} labels"
    return f"{text}   stopped: {row['stopped']}" if "stopped" in row else text


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the rounds; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("weights", type=Path, help="of the network to begin with")
    parser.add_argument("--out", type=Path, required=True, help="folder of the rounds")
    parser.add_argument("--garment", default="towel", choices=("towel", "tshirt"))
    parser.add_argument("--rounds", type=int, default=1, help="of fine-tuning")
    parser.add_argument("--episodes", type=int, default=5, help="per round, of the same starts")
    parser.add_argument("--garment-seed", type=int, help="one garment in every episode")
    parser.add_argument("--old", type=Path, help="simulated states to mix in")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seed", type=int, default=0, help="of the first episode")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE",
        help="a setting, such as flatten.actions=5 or hindsight=False",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    from shared.self_improvement import ImprovementConfig, improve_rounds

    try:
        config = ImprovementConfig(rounds=options.rounds, episodes=options.episodes)
        curve = improve_rounds(
            options.weights, options.out, options.garment, with_settings(config, options.set),
            garment_seed=options.garment_seed, old=options.old, device=options.device,
            seed=options.seed,
        )  # fmt: skip
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say("\n".join(map(in_words, curve)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
