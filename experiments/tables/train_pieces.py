"""Train the token network on packed states for a limited time, and leave it in pieces.

    python experiments pack_states out/towels out/shirts --output out/packs
    PYTHONPATH=src python experiments/tables/train_pieces.py --packs out/packs/*
        --start src/clothtrack/reconstruction/weights/tokens.safetensors
        --device cuda --seconds 540 --output out/pieces

For a GPU that is there for minutes at a time, on a machine that has PyTorch, NumPy, SciPy, OpenCV,
safetensors and jaxtyping and nothing else. Pictures are rendered on the device. The next run, on
any machine, goes on from the pieces:

    ... train_pieces.py (the same options) --pieces out/pieces --output out/pieces

It may name other packs. The rate rises, stays, and falls once: --fall-examples, in the last runs.
--join puts the pieces together in --folder, where model.safetensors, the average of the weights
with the lowest held-out error, works wherever weights are asked for. --measure says whether the
device renders what the processor does and what rendering and learning cost, and trains nothing.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import _path  # noqa: F401
from shared.figures import say

from clothtrack.errors import ClothTrackError
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.reconstruction.tokens.packed_states import PackedStates, read_pack
from clothtrack.reconstruction.tokens.packed_training import pretrain_packed
from clothtrack.reconstruction.tokens.token_network import EMPTY, TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_pictures import TokenPictures
from clothtrack.reconstruction.tokens.token_stage import TokenBatch, TokenStage
from clothtrack.reconstruction.training.pieces import join_pieces, write_pieces
from clothtrack.reconstruction.training.processes import Processes, require_torch_device
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import SCALARS, read_scalars
from clothtrack.reconstruction.training.training_run import PROGRESS, WEIGHTS

FILES = (PROGRESS, WEIGHTS, "model.safetensors", SCALARS)

END_S = 20.0
"""What is kept of the time for the last measurement and the pieces [s]."""

SHOW_S = 10.0
"""Time between two lines of progress [s]."""


@dataclass
class Watch:
    """Shows how fast a training is, and copies its files in pieces now and then."""

    options: argparse.Namespace
    begun_s: float
    first: int = -1
    steps: int = 0
    shown_s: float = field(default_factory=time.monotonic)
    copied_s: float = field(default_factory=time.monotonic)

    def __call__(self, place: str, done: int, total: int) -> None:
        """Note a step."""
        del done, total
        self.steps += 1
        now = time.monotonic()
        if self.steps == 1:
            # The first step compiles and measures what the next ones do not.
            self.first_s = now
        if now - self.shown_s > SHOW_S:
            rate = (self.steps - 1) * self.options.batch_size / max(now - self.first_s, 1e-9)
            say(f"{now - self.begun_s:.0f} s: {place}, {rate:.0f} examples/s\n")
            self.shown_s = now
        if now - self.copied_s > self.options.copy_seconds:
            copied(self.options)
            self.copied_s = time.monotonic()


def copied(options: argparse.Namespace) -> list[str]:
    """Write the pieces of what is in the work folder."""
    most = int(options.piece_mib * 2**20)
    return write_pieces(options.folder, FILES, options.output, most_bytes=most)


def trained(options: argparse.Namespace, begun_s: float) -> None:
    """Train until the time is over, and write the pieces."""
    network = TokenNetworkConfig(
        width=options.width, layers=options.layers, hypotheses=options.hypotheses
    )
    config = TrainingConfig(
        batch_size=options.batch_size, low_rate=1e-6, high_rate=options.rate, decay="stable",
        rise_examples=options.rise_examples, fall_examples=options.fall_examples,
        average_examples=options.average_examples, evaluate_examples=options.evaluate_examples,
        gradient_limit=1.0, held_out_share=options.held_out_share, log_steps=50,
        save_steps=options.save_steps, bfloat16=True, seed=options.seed,
    )  # fmt: skip
    left_s = options.seconds - (time.monotonic() - begun_s) - END_S
    watch = Watch(options, begun_s)
    outcome = pretrain_packed(
        options.packs, network, config, options.folder, asked=options.asked, start=options.start,
        hours=max(left_s, 0.0) / 3600.0, processes=Processes(device=options.device),
        progress=watch,
    ).stages["tokens"]  # fmt: skip
    names = copied(options)
    for row in read_scalars(options.folder):
        if row["split"] == "held_out":
            figures = " ".join(f"{name} {row[name]:.4f}" for name in SHOWN if name in row)
            say(f"{row['step'] * options.batch_size} examples: held out {figures}\n")
    say(
        f"{outcome.status} after {outcome.steps} steps, {outcome.steps * options.batch_size} "
        f"examples, best {outcome.best_score:.4f} at step {outcome.best_step}; "
        f"{', '.join(names)} in {options.output}\n"
    )


SHOWN = ("place_error", "nearest_error", "name_loss", "edge_ratio")


def measured(options: argparse.Namespace) -> None:
    """Say what rendering a batch and learning from it cost, for batches of several sizes."""
    import torch

    states = PackedStates.joined([read_pack(path)[0] for path in options.packs])
    network = TokenNetworkConfig(
        width=options.width, layers=options.layers, hypotheses=options.hypotheses
    )
    device = options.device
    pictures = TokenPictures(
        states, network, device=device, asked=options.asked, part_pixels=options.part_pixels
    )
    model = TokenNetwork(network).to(device, memory_format=torch.channels_last)
    stage = TokenStage(model).train()
    optimizer = torch.optim.Adam(stage.parameters(), lr=1e-6, fused=True)

    def learn(batch: TokenBatch) -> None:
        with torch.autocast(device.split(":")[0], torch.bfloat16):
            loss = stage(batch)["loss"]
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()

    say(agreement(states, network, device))
    for size in options.measure:
        chosen = torch.arange(size) % len(states)
        render_s = timed(partial(pictures.batch, chosen, (0,)), device, options.repeats)
        batch = pictures.batch(chosen, (0,))
        learn_s = timed(partial(learn, batch), device, options.repeats)
        memory = torch.cuda.max_memory_allocated() / 2**30 if device.startswith("cuda") else 0.0
        say(
            f"batch {size}: render {1e3 * render_s / size:.3f} ms, learn "
            f"{1e3 * learn_s / size:.3f} ms an example: {size / (render_s + learn_s):.0f} "
            f"examples/s; most memory of the GPU {memory:.1f} GiB\n"
        )


def agreement(states: PackedStates, network: TokenNetworkConfig, device: str) -> str:
    """Say how far pictures of exact sensors on a device are from those on the processor."""
    import torch

    exact = SensorConfig.perfect()
    config = RenderConfig(sensors=(exact,) * 3, mask_jitter=0.0)
    chosen = torch.arange(min(len(states), COMPARED))
    here, there = (
        TokenPictures(states, network, rendering=config, device=one).batch(chosen, (0,))
        for one in ("cpu", device)
    )
    first, second = here.height, there.height.cpu()
    both = (first > 0.5 * EMPTY) & (second > 0.5 * EMPTY)
    either = (first > 0.5 * EMPTY) | (second > 0.5 * EMPTY)
    apart = torch.quantile((first - second)[both][:LARGEST].abs(), 0.99)
    places = (here.places - there.places.cpu()).abs().max()
    return (
        f"{device} and the processor see cloth in the same {100.0 * both.sum() / either.sum():.2f} "
        f"% of the pixels, 99 % of the heights are within {float(apart):.1e} and all places within "
        f"{float(places):.1e} of the garment's size\n"
    )


COMPARED = 64
"""States that are rendered on both devices."""

LARGEST = 10_000_000
"""Numbers of which PyTorch takes a quantile."""


def timed(work: Callable[[], object], device: str, repeats: int) -> float:
    """Median time of some work [s], waited for; process time on a processor."""
    import torch

    on_gpu = device.startswith("cuda")
    clock, times = time.perf_counter if on_gpu else time.process_time, []
    for _ in range(repeats + 1):
        start = clock()
        work()
        if on_gpu:
            torch.cuda.synchronize()
        times.append(clock() - start)
    # The first one allocates.
    return sorted(times[1:])[repeats // 2]


def run(options: argparse.Namespace) -> None:
    """Train, measure, or put pieces together."""
    begun_s = time.monotonic()
    if options.pieces is not None and not (options.folder / PROGRESS).exists():
        say(f"{', '.join(join_pieces(options.pieces, options.folder))} in {options.folder}\n")
    if options.join:
        return
    import torch

    require_torch_device(options.device)
    torch.set_num_threads(1)
    torch.set_float32_matmul_precision("high")
    if options.measure:
        measured(options)
    else:
        trained(options, begun_s)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    options = parser().parse_args(arguments)
    if not (options.join or options.packs):
        parser().error("give --packs FILE..., or --join")
    try:
        run(options)
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    made = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    sizes = TokenNetworkConfig()
    made.add_argument("--packs", nargs="+", type=Path, default=[], help="files of `pack_states`")
    made.add_argument("--start", type=Path, help="weights that the first run begins with")
    made.add_argument("--pieces", type=Path, help="pieces of the run before, if there was one")
    made.add_argument("--output", type=Path, default=Path("out/pieces"), help="gets the pieces")
    made.add_argument(
        "--folder", type=Path, default=Path("out/run"), help="of the progress, on this machine"
    )
    made.add_argument("--device", default="cuda", help="cuda, or cpu")
    made.add_argument("--seconds", type=float, default=540.0, help="of wall time, all included")
    made.add_argument("--join", action="store_true", help="only put pieces together in --folder")
    made.add_argument("--measure", nargs="+", type=int, help="only measure batches of these sizes")
    made.add_argument("--part-pixels", type=int, help="drawn together, in what is measured")
    made.add_argument("--repeats", type=int, default=20, help="of what is measured")
    made.add_argument("--batch-size", type=int, default=256, help="examples per step")
    made.add_argument("--rate", type=float, default=1.5e-3, help="the rate that stays")
    made.add_argument("--rise-examples", type=int, default=100_000, help="of the rate, at first")
    made.add_argument("--fall-examples", type=int, default=0, help="of the rate, at the end")
    made.add_argument("--average-examples", type=int, default=200_000, help="of the weights")
    made.add_argument("--evaluate-examples", type=int, default=500_000, help="between measurements")
    made.add_argument("--held-out-share", type=float, default=0.03, help="of the garments")
    made.add_argument("--asked", type=int, default=192, help="pixels per picture that are named")
    made.add_argument("--width", type=int, default=sizes.width, help="of the network")
    made.add_argument("--layers", type=int, default=sizes.layers, help="of the network")
    made.add_argument("--hypotheses", type=int, default=sizes.hypotheses, help="of the network")
    made.add_argument("--seed", type=int, default=0, help="of everything random")
    made.add_argument("--save-steps", type=int, default=1_000, help="between two saves")
    made.add_argument("--copy-seconds", type=float, default=150.0, help="between two copies")
    made.add_argument("--piece-mib", type=float, default=15.0, help="most of one piece [MiB]")
    return made


if __name__ == "__main__":
    sys.exit(main())
