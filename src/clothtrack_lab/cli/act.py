"""The verbs of the command line that act: flattening, its learned dynamics, and getting better."""

import json as json_module
from collections.abc import Iterable
from contextlib import closing, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from clothtrack.cli.options import (
    AsJson,
    Device,
    Ray,
    Seed,
    Settings,
    ShowSettings,
    list_settings,
    require_weights,
)
from clothtrack.cli.terminal import TERMINATED, complain, progress, say, say_result
from clothtrack.errors import InvalidConfigError
from clothtrack.front.learning_extra import require_learning
from clothtrack_lab.extra import require_lab

if TYPE_CHECKING:
    from clothtrack.planning.flatten_config import FlattenConfig
    from clothtrack.reconstruction.training.training_run import TrainingOutcome

PerceptionChoice = Literal["network", "tracker", "truth"]
PolicyChoice = Literal["planned", "random", "outwards", "heuristic"]


def flatten(
    output: Positional[Path],
    *,
    garment: Literal["towel", "tshirt"] = "towel",
    template: Path | None = None,
    garment_seed: int | None = None,
    robot: Literal["simulated", "dry-run"] = "simulated",
    perception: PerceptionChoice = "network",
    weights: Path | None = None,
    policy: PolicyChoice = "planned",
    dynamics: Literal["simulator", "mesh"] = "simulator",
    dynamics_weights: Path | None = None,
    recording: Path | None = None,
    actions: int = 10,
    episodes: int = 1,
    workers: int = 1,
    ray: Ray = "",
    live: bool = False,
    port: int | None = None,
    settings: Settings = (),
    show_settings: ShowSettings = False,
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Flatten a crumpled garment: perceive, plan, act, and look again.

    Args:
        output: folder for episodes/, recordings/, truth/ and one report per episode; an
            interrupted episode goes on with the same command.
        garment: what lies on the table.
        template: the garment's own mesh (`clothtrack garment`), of one layer for a towel, of two
            for a tshirt.
        garment_seed: the same garment in every episode, of a cut, size and thickness that no
            shipped network was trained on; SEED draws start, noise and candidates alone.
        robot: one in the simulated world, or none: plans are written down and nothing moves.
        perception: the network's mesh of each picture, or the tracker's carried on; truth is a
            control (an upper bound, no result) and simulated only.
        weights: of the reconstruction network; the ones that come with clothtrack by default.
        policy: planned; or, without any mesh, random actions, the place farthest off the cloth of
            a hundred, or the farthest corner outwards.
        dynamics: what a plan is tried in: our simulator, or the learned mesh dynamics.
        dynamics_weights: of the learned ones (`train-dynamics`); the ones that come with clothtrack
            by default.
        recording: for a dry run: its last picture is what is planned for.
        actions: most actions of an episode.
        episodes: how many, with the seeds SEED, SEED + 1 and so on.
        workers: processes; each runs one episode at a time.
        ray: address of Ray, which is to do it.
        live: show it in a browser while it happens, on this machine only.
        port: of that page; any free one by default.
        settings: changes, such as planner.candidates=300 or planner.strip_m=0.
        show_settings: list all settings with their values and do nothing else.
        device: where to compute.
        seed: of garment, start, noise and candidates.
        json: machine-readable.
    """
    config = _config(
        policy, perception, weights, dynamics, dynamics_weights, template=template,
        actions=actions, settings=settings,
    )  # fmt: skip
    if show_settings:
        return list_settings(config)
    if problem := _excluded(robot, recording, template, garment_seed):
        complain(problem)
        return 2
    if recording is not None:
        return _dry_run(output, recording, config, device=device, seed=seed)
    if episodes < 1:
        raise InvalidConfigError(f"--episodes is {episodes}; give at least 1")
    if live and (workers != 1 or ray):
        complain("--live shows one process; leave out --workers and --ray, or --live")
        return 2
    from clothtrack.report.flattening_page import watched_live

    require_lab()
    from clothtrack_lab.flattening import episode_parts
    from clothtrack_lab.many_episodes import flatten_many

    # Before the first start is made and the page is served: weights may be missing.
    parts = episode_parts(garment, config, device=device, garment_seed=garment_seed, output=output)
    write = complain if json else say  # The result on stdout stays JSON alone.
    opened = watched_live(port, opened=lambda address: write(f"{address}   open this"))
    with opened if live else nullcontext() as watch:
        flattened = flatten_many(
            output, garment, config, range(seed, seed + episodes), garment_seed=garment_seed,
            device=device, parts=parts, watch=watch, workers=workers, ray=ray, progress=progress,
        )  # fmt: skip
        with closing(flattened):
            _say_episodes(flattened, json=json)
    return 0


def _say_episodes(episodes: Iterable[dict[str, Any]], *, json: bool) -> None:
    """Write a line per episode as it ends, or one JSON document at the end."""
    rows = []
    for row in episodes:
        rows.append(row)
        control = "   CONTROL" if row["control"] else ""
        if not json:
            say(
                f"{row['report']}   improvement {row['improvement'][-1]:.2f} after "
                f"{row['actions']} actions; {row['status']}{control}"
            )
    if json:
        say(json_module.dumps(rows, indent=2))


def _excluded(
    robot: str, recording: Path | None, template: Path | None, garment_seed: int | None
) -> str:
    """Which options of `flatten` exclude each other; empty where none do."""
    if garment_seed is not None and (robot == "dry-run" or template is not None):
        given = "--template" if template is not None else "--robot dry-run"
        return f"--garment-seed draws a garment of the simulated world; leave {given} out"
    if robot == "dry-run" and recording is None:
        return "a dry run plans for a picture; name its --recording"
    if robot == "simulated" and recording is not None:
        return "--recording is for --robot dry-run; the simulated robot has its own camera"
    return ""


def train_dynamics(
    output: Positional[Path],
    *,
    garment: tuple[Literal["towel", "tshirt"], ...] = ("towel", "tshirt"),
    roll_outs: int = 2000,
    only_roll_outs: bool = False,
    settings: Settings = (),
    workers: int = 1,
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Train the mesh dynamics of `flatten --dynamics mesh` on roll-outs of our simulator.

    The same command goes on where an interrupted one stopped.

    Args:
        output: folder for roll_outs/GARMENT/ and model/best.safetensors, with its card.
        garment: what is rolled out; one network learns from all of them.
        roll_outs: at least so many of each garment, in whole shards; finished ones are kept.
        only_roll_outs: make them, and train nothing.
        settings: changes, such as loop.epochs=20 or network.width=64; those that begin with
            roll_outs. are of the roll-outs.
        workers: processes that make roll-outs.
        device: where to train.
        seed: of roll-outs, weights and order.
        json: machine-readable.
    """
    from clothtrack.files.output_lock import locked_output
    from clothtrack.files.settings import with_settings
    from clothtrack_lab.graph_dynamics.roll_outs import (
        RollOutConfig,
        frames_per_step,
        generate_roll_outs,
    )

    mine = [one for one in settings if not one.startswith("roll_outs.")]
    theirs = [one.removeprefix("roll_outs.") for one in settings if one.startswith("roll_outs.")]
    if not garment:
        raise InvalidConfigError("--garment names nothing; give towel, tshirt or both")
    recipe = with_settings(RollOutConfig(), theirs)

    def make() -> list[Path]:
        # Named twice, its shards would be learned from and held out at once.
        return [
            shard
            for kind in dict.fromkeys(garment)
            for shard in generate_roll_outs(
                output / "roll_outs" / kind, kind, roll_outs, seed=seed, config=recipe,
                processes=workers, progress=progress,
            )
        ]  # fmt: skip

    if only_roll_outs:
        with locked_output(output):
            say(f"{output / 'roll_outs'}   ({len(make())} shards)")
        return 0
    # What cannot be trained is refused before anything is rolled out.
    require_learning()
    from clothtrack.reconstruction.training.processes import require_torch_device
    from clothtrack_lab.graph_dynamics.mesh_training import (
        DynamicsTrainingConfig,
        train_mesh_dynamics,
    )

    require_torch_device(device)
    config = DynamicsTrainingConfig()
    config = with_settings(replace(config, loop=replace(config.loop, seed=seed)), mine)
    frames_per_step(config.network.step_s, recipe.frame_s)
    names = ", ".join(dict.fromkeys(garment))
    with locked_output(output):
        outcome = train_mesh_dynamics(
            make(), names, config, output / "model", device=device, progress=progress
        )
    return _say_outcome(outcome, json=json)


def _say_outcome(outcome: "TrainingOutcome", *, json: bool) -> int:
    """Say how a training ended, and give the exit status."""
    text = (
        f"{outcome.weights}   {outcome.status} after {outcome.steps} steps; best held-out "
        f"error {outcome.best_score:.2f} mm after {outcome.best_step}"
    )
    say_result(text, asdict(outcome), json=json)
    if outcome.status == "interrupted":
        complain("interrupted; the same command goes on from there")
        return TERMINATED
    return 0


def _config(
    policy: PolicyChoice,
    perception: PerceptionChoice,
    weights: Path | None,
    dynamics: Literal["simulator", "mesh"],
    dynamics_weights: Path | None,
    *,
    template: Path | None = None,
    actions: int,
    settings: Settings,
) -> "FlattenConfig":
    from clothtrack.files.settings import with_settings
    from clothtrack.planning.flatten_config import FlattenConfig
    from clothtrack.planning.perception import PerceptionConfig

    for path in (weights, dynamics_weights):
        if path is not None:
            require_weights(path)
    if dynamics == "mesh" or (policy == "planned" and perception != "truth"):
        require_learning()
    config = FlattenConfig(
        policy=policy,
        perception=PerceptionConfig(
            name=perception, weights=str(weights or ""), template=str(template or "")
        ),
        dynamics=dynamics,
        dynamics_weights=str(dynamics_weights or ""),
        actions=actions,
    )
    return with_settings(config, settings)


def _dry_run(
    output: Path, recording: Path, config: "FlattenConfig", *, device: str, seed: int
) -> int:
    """Plan one action for the last picture of a recording."""
    require_lab()
    from clothtrack_lab.flattening import plan_flattening

    store = plan_flattening(recording, output, config, seed=seed, device=device)
    plans = sorted(output.glob("action_*.png"))
    if not plans:
        complain(f"no plan: {store.document['status']}")
        return 1
    say("\n".join(map(str, plans)))
    return 0
