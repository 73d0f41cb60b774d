"""Train the learned dynamics that `flatten` can plan with."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from clothtrack.errors import InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.files.progress import Progress
    from clothtrack.reconstruction.training.training_run import TrainingOutcome


def train_dynamics(
    output: Path | str,
    *,
    garments: Sequence[Literal["towel", "tshirt"]] = ("towel", "tshirt"),
    roll_outs: int = 2000,
    settings: Sequence[str] = (),
    workers: int = 1,
    device: str = "cpu",
    seed: int = 0,
    progress: "Progress | None" = None,
) -> "TrainingOutcome":
    """Train the mesh dynamics of `flatten --dynamics mesh` on roll-outs of our simulator.

    The same call resumes an interrupted run.

    Args:
        output: folder for roll_outs/GARMENT/ and model/best.safetensors with its card.
        garments: kinds of garments to roll out; one network is trained on all of them.
        roll_outs: least number of roll-outs of each garment, in whole shards; finished ones are
            kept.
        settings: changes, such as loop.epochs=20 or network.width=64; the prefix roll_outs. changes
            the roll-outs.
        workers: number of processes that make roll-outs.
        device: device to train on: "cpu" or "cuda:0".
        seed: seed of roll-outs, weights and order.
        progress: function called after every shard and step.

    Returns:
        The outcome of the training and its weights.

    Raises:
        InvalidConfigError: no garment is given, a setting is unknown, or another run writes to
            `output`.
    """
    from dataclasses import replace

    from clothtrack.api.options import require_learning
    from clothtrack.files.output_lock import locked_output
    from clothtrack.files.settings import with_settings

    # Check that training is possible before making any roll-outs.
    require_learning()
    from clothtrack.reconstruction.training.processes import require_torch_device
    from clothtrack_lab.graph_dynamics.mesh_training import (
        DynamicsTrainingConfig,
        train_mesh_dynamics,
    )
    from clothtrack_lab.graph_dynamics.roll_outs import (
        RollOutConfig,
        frames_per_step,
        generate_roll_outs,
    )

    output = Path(output)
    mine = [one for one in settings if not one.startswith("roll_outs.")]
    theirs = [one.removeprefix("roll_outs.") for one in settings if one.startswith("roll_outs.")]
    # A repeated garment would have its shards both trained on and held out.
    kinds = tuple(dict.fromkeys(garments))
    if not kinds:
        raise InvalidConfigError("garments names nothing; give towel, tshirt or both")
    recipe = with_settings(RollOutConfig(), theirs)
    require_torch_device(device)
    config = DynamicsTrainingConfig()
    config = with_settings(replace(config, loop=replace(config.loop, seed=seed)), mine)
    frames_per_step(config.network.step_s, recipe.frame_s)
    with locked_output(output):
        shards = [
            shard
            for kind in kinds
            for shard in generate_roll_outs(
                output / "roll_outs" / kind, kind, roll_outs, seed=seed, config=recipe,
                processes=workers, progress=progress,
            )
        ]  # fmt: skip
        return train_mesh_dynamics(
            shards, ", ".join(kinds), config, output / "model", device=device, progress=progress
        )
