"""Continue training the token network: fresh states of a seed, some hours of training, scoring.

    python experiments train_on --output OUT --seed 40 --hours 2 --data DIR

One call is one round. It simulates states that no other seed has, trains on all states of OUT for
so many hours of wall time, and judges the weights: held-out garments, fresh states of a seed of
their own (every vertex against the truth), and real pictures where DIR has some (`real_pictures`).
The next round, with another seed, continues from there: rate and moments stay, and there are more
states. The same command resumes an interrupted round.

    OUT/states/towel_40 ...    the states of each round
    OUT/judge/towel ...        the states that judge; nothing learns from them
    OUT/run                    progress, scalars, model.safetensors (the average of the weights)
    OUT/rounds.json            one row per judged round
    OUT/curve.png              error of held-out garments against examples seen

The first round begins with the shipped weights, or with --start. --fall EXAMPLES ends the
training: the rate falls to nothing over so many examples. --ship FILE writes the weights in half
precision, as those of the package are. `--smoke` trains an untrained network
on a handful of small states; its figures mean nothing.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _path  # noqa: F401
import numpy as np
from real import real_pictures
from shared.figures import plot_style, say, write_json

from clothtrack import __version__
from clothtrack.cli.terminal import progress
from clothtrack.errors import ClothTrackError, InvalidResultError
from clothtrack.files.atomic_write import content_hash
from clothtrack.files.provenance import commit
from clothtrack.files.settings import with_settings
from clothtrack.geometry.devices import quiet_warp
from clothtrack.reconstruction.availability import shipped_weights
from clothtrack.reconstruction.data.crumpling import CrumplingConfig
from clothtrack.reconstruction.data.state_store import StateSet, open_states
from clothtrack.reconstruction.data.states import StatesConfig, generate_states
from clothtrack.reconstruction.tokens.learning_config import LearningConfig
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_training import pretrain_tokens
from clothtrack.reconstruction.training.checkpoint import load_weights, save_weights
from clothtrack.reconstruction.training.processes import joined
from clothtrack.reconstruction.training.training_log import read_scalars
from tables import network_on_states

JUDGE_SEED = 77
"""Of the states that judge; no round may have it."""

SMALL = StatesConfig(
    vertex_count=250, episodes=2, crumpling=CrumplingConfig(states=2, rest_limit_s=0.2)
)


def states_of(options: argparse.Namespace, config: StatesConfig) -> list[StateSet]:
    """Return the states of all rounds, after those of this one are made."""
    folder = options.output / "states"
    for kind in options.garments:
        out = folder / f"{kind}_{options.seed}"
        say(f"{out}\n")
        generate_states(out, kind, options.states, seed=options.seed, config=config)
    return [open_states(path.parent) for path in sorted(folder.glob("*/states.json"))]


def trained(options: argparse.Namespace, states: Sequence[StateSet]) -> Path:
    """Return the weights after the hours of this round."""
    config = LearningConfig.preset("pretrain", seed=0)
    if options.smoke:
        config = with_settings(config, [
            "network.width=16", "network.layers=1", "tokens.batch_size=4",
            "tokens.held_out_share=0.3",
        ])  # fmt: skip
    config = replace(config, tokens=replace(config.tokens, fall_examples=options.fall))
    with joined("cpu") as alone:
        outcome = pretrain_tokens(
            states, config, options.output / "run", start=options.start,
            hours=options.hours, processes=alone, progress=progress,
        )  # fmt: skip
    if outcome.model is None:
        raise SystemExit(143)
    return outcome.model


def judged(options: argparse.Namespace, weights: Path, config: StatesConfig) -> dict[str, Any]:
    """Return one row: what the weights have seen, and how wrong they are."""
    if not weights.is_file():
        raise InvalidResultError(f"{weights}: there is no such file; train a round first")
    held = [one for one in read_scalars(options.output / "run") if one["split"] == "held_out"][-1]
    row: dict[str, Any] = {
        "seed": options.seed, "weights_sha256": content_hash(weights), "commit": commit(),
        "clothtrack": __version__, "step": held["step"],
        **{key: held[key] for key in ("place_error", "nearest_error", "name_loss", "edge_ratio")},
    }  # fmt: skip
    for kind in options.garments:
        folder = options.output / "judge" / kind
        generate_states(folder, kind, options.judge_states, seed=JUDGE_SEED, config=config)
        rows = options.output / "judge" / f"{kind}_{options.seed}.json"
        network_on_states.main(
            ["--states", str(folder), "--weights", str(weights), "--json", str(rows), "--refined",
             "--every", str(options.judge_every)]
        )  # fmt: skip
        row[kind] = _errors(json.loads(rows.read_text(encoding="utf-8"))["rows"])
    if options.data is not None:
        file = options.output / "judge" / f"pictures_{options.seed}.json"
        real_pictures.main(
            ["--data", str(options.data), "--weights", str(weights), "--json", str(file)]
        )
        report = json.loads(file.read_text(encoding="utf-8"))
        row["pictures"] = {
            name: {key: value for key, value in report[name].items() if key != "rows"}
            for name in report
            if name != "provenance"
        }
    return row


def _errors(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | int]:
    """Return the mean error of all states and of heaps [mm], and how many states gave no mesh."""
    good = [row for row in rows if "error" not in row]
    heaps = [row["error_mm"] for row in good if row["coverage"] < network_on_states.HEAP]
    return {
        "all_mm": float(np.mean([row["error_mm"] for row in good])) if good else float("nan"),
        "heaps_mm": float(np.mean(heaps)) if heaps else float("nan"),
        "states": len(good), "without_mesh": len(rows) - len(good),
    }  # fmt: skip


def ship(weights: Path, file: Path) -> None:
    """Write weights in half precision, and say by what digest they are known."""
    whole = load_weights(weights)
    halves = {
        name: value.half() if value.is_floating_point() else value
        for name, value in whole.tensors.items()
    }
    sizes = TokenNetworkConfig(**whole.network)
    save_weights(file, halves, sizes, kind=whole.kind, provenance=whole.provenance)
    count = sum(value.numel() for value in halves.values())
    say(f"{file}: {count} numbers, SHA-256 {content_hash(file)}\n")


def draw_curve(run: Path, file: Path, batch_size: int) -> None:
    """Draw the error of held-out garments against examples seen."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    held = [one for one in read_scalars(run) if one["split"] == "held_out"]
    seen = batch_size * np.array([one["step"] for one in held])
    with plt.rc_context(plot_style(title_size=10)):
        figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
        for name, label in (("place_error", "likeliest"), ("nearest_error", "nearest of all")):
            axes[0].plot(seen, [one[name] for one in held], label=label)
        axes[0].set(xlabel="examples", ylabel="place error, over the longer side")
        axes[0].legend(frameon=False)
        axes[1].plot(seen, [one["name_loss"] for one in held])
        axes[1].set(xlabel="examples", ylabel="correspondences, nat")
        figure.savefig(file, dpi=120)
        plt.close(figure)


def run(options: argparse.Namespace) -> None:
    """One round."""
    config = SMALL if options.smoke else StatesConfig()
    if options.ship is not None:
        ship(options.output / "run" / "model.safetensors", options.ship)
        return
    if not options.judge_only:
        weights = trained(options, states_of(options, config))
    else:
        weights = options.output / "run" / "model.safetensors"
    row = judged(options, weights, config)
    file = options.output / "rounds.json"
    rows = json.loads(file.read_text(encoding="utf-8"))["rounds"] if file.exists() else []
    batch = 4 if options.smoke else LearningConfig.preset("pretrain").tokens.batch_size
    rows = [one for one in rows if one["step"] != row["step"]]
    write_json(file, {"rounds": [*rows, {**row, "examples": batch * row["step"]}]})
    draw_curve(options.output / "run", options.output / "curve.png", batch)
    say(json.dumps(row, indent=1) + "\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, help="folder of the training")
    parser.add_argument("--seed", type=int, default=40, help="of this round's states")
    parser.add_argument("--hours", type=float, default=2.0, help="of training in this round")
    parser.add_argument("--states", type=int, default=1500, help="fresh ones of each garment")
    parser.add_argument(
        "--garments", nargs="+", default=["towel", "tshirt"], help="kinds to simulate and judge"
    )
    parser.add_argument("--start", type=Path, help="weights that the first round begins with")
    parser.add_argument("--fall", type=int, default=0, help="examples over which the rate falls")
    parser.add_argument("--data", type=Path, help="folder of real pictures (real_pictures)")
    parser.add_argument("--judge-states", type=int, default=200, help="of each garment")
    parser.add_argument("--judge-every", type=int, default=5, help="so many of them, one is asked")
    parser.add_argument(
        "--judge-only", action="store_true", help="judge the weights that are there"
    )
    parser.add_argument("--ship", type=Path, help="write the weights in half precision, no more")
    parser.add_argument("--smoke", action="store_true", help="a handful of small states")
    options = parser.parse_args(arguments)
    if options.output is None and not options.smoke:
        parser.error("give --output DIR, or --smoke")
    if options.seed == JUDGE_SEED:
        parser.error(f"--seed {JUDGE_SEED} makes the states that judge; take another")
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="train-on-") as temporary:
        if options.smoke:
            options.output = options.output or Path(temporary)
            options.hours, options.states, options.judge_states = 0.002, 12, 4
            options.judge_every, options.fall = 2, 0
        elif options.start is None:
            options.start = shipped_weights()
        try:
            run(options)
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
