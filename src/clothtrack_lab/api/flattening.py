"""Flatten crumpled garments: perceive, plan, act, and look again."""

from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clothtrack.api.options import Ray, Settings, configured_by, require_file
from clothtrack.api.results import Many
from clothtrack.errors import InvalidConfigError, InvalidResultError, WrongUsageError
from clothtrack_lab.extra import require_lab

if TYPE_CHECKING:
    from clothtrack.files.progress import Progress
    from clothtrack.planning.flatten_config import FlattenConfig

Perception = Literal["network", "truth"]
Policy = Literal["planned", "random", "outwards", "heuristic"]


@dataclass(frozen=True)
class Episode:
    """The outcome of an episode.

    Attributes:
        summary: JSON content: the report's path, the improvement after each action, the status, and
            whether it is a control.
    """

    summary: dict[str, Any]

    def text(self) -> str:
        """Return a one-line summary."""
        row = self.summary
        control = "   CONTROL" if row["control"] else ""
        return (
            f"{row['report']}   improvement {row['improvement'][-1]:.2f} after "
            f"{row['actions']} actions; {row['status']}{control}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the summary."""
        return self.summary


@dataclass(frozen=True)
class Plan:
    """The plan of a dry run.

    Attributes:
        picture: picture of the action.
    """

    picture: Path

    def text(self) -> str:
        """Return a message with its path."""
        return str(self.picture)

    as_dict = text


def _flattening_config(
    *,
    perception: Perception = "network",
    weights: Path | str | None = None,
    policy: Policy = "planned",
    dynamics: Literal["simulator", "mesh"] = "simulator",
    dynamics_weights: Path | str | None = None,
    template: Path | str | None = None,
    actions: int = 10,
    settings: Sequence[str] = (),
) -> "FlattenConfig":
    """Return the configuration that `flatten_many` uses; the arguments are the same.

    Raises:
        InvalidConfigError: a setting is unknown, or weights or an extra are missing.
    """
    from clothtrack.api.options import require_learning
    from clothtrack.files.settings import with_settings
    from clothtrack.planning.flatten_config import FlattenConfig
    from clothtrack.planning.perception import PerceptionConfig

    for path in (weights, dynamics_weights):
        require_file(path, "weights")
    if dynamics_weights is not None and dynamics != "mesh":
        raise InvalidConfigError(
            "--dynamics-weights are of the learned dynamics; add --dynamics mesh, or leave them out"
        )
    if dynamics == "mesh" or (policy == "planned" and perception != "truth"):
        require_learning()
    seen = PerceptionConfig(
        name=perception, weights=str(weights or ""), template=str(template or "")
    )
    config = FlattenConfig(
        policy=policy, perception=seen, dynamics=dynamics,
        dynamics_weights=str(dynamics_weights or ""), actions=actions,
    )  # fmt: skip
    return with_settings(config, settings)


@configured_by(_flattening_config)
def flatten_many(
    output: Path | str,
    *,
    garment: Literal["towel", "tshirt"] = "towel",
    template: Path | str | None = None,
    garment_seed: int | None = None,
    recording: Path | str | None = None,
    perception: Perception = "network",
    weights: Path | str | None = None,
    policy: Policy = "planned",
    dynamics: Literal["simulator", "mesh"] = "simulator",
    dynamics_weights: Path | str | None = None,
    actions: int = 10,
    episodes: int = 1,
    workers: int = 1,
    ray: Ray = "",
    live: bool = False,
    settings: Settings = (),
    device: str = "cpu",
    seed: int = 0,
    progress: "Progress | None" = None,
    opened: "Callable[[str], None] | None" = None,
    each: "Callable[[Episode | Plan], None] | None" = None,
) -> Many[Episode | Plan]:
    """Flatten a crumpled garment in the simulated world: perceive, plan, act, and look again.

    With --recording nothing moves; one action is planned for its last picture and saved.

    Args:
        output: folder for episodes/, recordings/, truth/ and one report per episode; the same
            command resumes an interrupted episode.
        garment: kind of garment on the table.
        template: mesh of this garment (`clothtrack garment`), with one layer for a towel and two
            for a tshirt.
        garment_seed: use the same garment in every episode, with a cut, size and thickness that no
            shipped network was trained on; SEED then draws only start, noise and candidates.
        recording: plan for the last picture of this recording without moving anything (a dry run).
        perception: source of the mesh of each picture: the network, or, only in simulation, the
            truth, which is a control (an upper bound, not a result).
        weights: weights of the reconstruction network; the shipped ones by default.
        policy: planned, or one of the policies without a mesh: random actions, the place farthest
            off the cloth out of a hundred, or the farthest corner pulled outwards.
        dynamics: dynamics used for planning: our simulator, or the learned mesh dynamics.
        dynamics_weights: weights of the learned dynamics (`clothtrack_lab.train_dynamics`); the
            shipped ones by default.
        actions: largest number of actions per episode.
        episodes: number of episodes, with the seeds SEED, SEED + 1 and so on.
        workers: number of processes; each runs one episode at a time.
        ray: address of the Ray cluster to run on; 'local' for this machine.
        live: show the episode live in a browser, on this machine only.
        settings: changes, such as planner.candidates=300 or planner.strip_m=0.
        device: device to compute on: cpu, or cuda:0.
        seed: seed of garment, start, noise and candidates.
        progress: function called with every action (in one process) or after every episode.
        opened: function called with the page's address.
        each: function called with each episode as it ends.

    Raises:
        InvalidConfigError: the options contradict each other, or another run writes to `output`.
        InvalidResultError: weights are missing or damaged, or there is no plan.
        ClothTrackError: an episode failed (raised after all others have ended), or a worker died.
    """
    from clothtrack.geometry.devices import quiet_warp

    quiet_warp()
    output = Path(output)
    config = _flattening_config(
        perception=perception, weights=weights, policy=policy, dynamics=dynamics,
        dynamics_weights=dynamics_weights, template=template, actions=actions, settings=settings,
    )  # fmt: skip
    dry = recording is not None
    if garment_seed is not None and (dry or template is not None):
        given = "--template" if template is not None else "--recording"
        raise WrongUsageError(
            f"--garment-seed draws a garment of the simulated world; leave {given} out"
        )
    if recording is not None:
        plans = _dry_run(output, Path(recording), config, device=device, seed=seed)
        if each is not None:
            for plan in plans:
                each(plan)
        return Many(plans)
    if episodes < 1:
        raise InvalidConfigError(f"--episodes is {episodes}; give at least 1")
    if live and (workers != 1 or ray):
        raise WrongUsageError("--live shows one process; leave out --workers and --ray, or --live")
    from clothtrack.report.flattening_page import watched_live

    require_lab()
    from clothtrack_lab.flattening import episode_parts
    from clothtrack_lab.many_episodes import run_episodes

    # Load the parts before making a start and serving the page, because weights may be missing.
    parts = episode_parts(garment, config, device=device, garment_seed=garment_seed, output=output)
    found = []
    with watched_live(opened=opened) if live else nullcontext() as watch:
        flattened = run_episodes(
            output, garment, config, range(seed, seed + episodes), garment_seed=garment_seed,
            device=device, parts=parts, watch=watch, workers=workers, ray=ray, progress=progress,
        )  # fmt: skip
        with closing(flattened) as rows:
            for row in rows:
                found.append(Episode(row))
                if each is not None:
                    each(found[-1])
    return Many(tuple(found))


def _dry_run(
    output: Path, recording: Path, config: "FlattenConfig", *, device: str, seed: int
) -> tuple[Plan, ...]:
    """Plan one action for the last picture of a recording; return the pictures of the plan."""
    require_lab()
    from clothtrack_lab.flattening import plan_flattening

    store = plan_flattening(recording, output, config, seed=seed, device=device)
    plans = tuple(map(Plan, sorted(output.glob("action_*.png"))))
    if not plans:
        raise InvalidResultError(f"no plan: {store.document['status']}")
    return plans
