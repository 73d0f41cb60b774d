"""Flattening of one cloth in the simulated world, and planning for a recorded one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.files.progress import Progress
from clothtrack.files.settings import with_settings
from clothtrack.garments.garment_meshes import GarmentKind
from clothtrack.geometry.devices import quiet_warp
from clothtrack.planning.action_space import (
    ActionSpace,
    PickPlace,
    SeenCloth,
    edge_measure,
    off_cloth,
    sample_actions,
    within_limits,
)
from clothtrack.planning.episode_store import EpisodeStore
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
from clothtrack.planning.flattening import EpisodeScene, Flattening, Propose, Watch, flat_area
from clothtrack.planning.perception import perception_of
from clothtrack.planning.planner import PlannerConfig
from clothtrack.planning.robots.dry_run import DryRunRobot, pictures_of
from clothtrack.planning.robots.robot import MotionLimits
from clothtrack.planning.seen import seen_area
from clothtrack.recordings.store import read_recording
from clothtrack_lab.world.bench import vary
from clothtrack_lab.world.one_garment import OneGarment
from clothtrack_lab.world.simulated_episodes import (
    EpisodeParts,
    SimulatedEpisode,
    flatten_simulated,
    knowing_the_garment,
    shared_parts,
)
from clothtrack_lab.world.simulated_robot import SimulatedRobotConfig


def flatten(
    output: Path | str,
    garment: GarmentKind = "towel",
    *,
    template: Path | str | None = None,
    garment_seed: int | None = None,
    config: FlattenConfig | None = None,
    settings: Sequence[str] = (),
    seed: int = 0,
    device: str = "cpu",
    parts: EpisodeParts | None = None,
    watch: Watch | None = None,
    progress: Progress | None = None,
) -> EpisodeStore:
    """Flatten a crumpled garment in the simulated world: perceive, plan, act, and look again.

    Args:
        output: folder for the episode, its recording and its truth; an interrupted episode is
            resumed.
        garment: kind of garment on the table.
        template: file of the garment's template (`clothtrack garment`); a usual cut by default.
        garment_seed: use one garment, which no shipped network was trained on, for every `seed`;
            the perception is given its template, and it has its own camera. By default each seed
            has its own garment.
        config: configuration, changed by `settings`.
        settings: changes, such as "actions=3" or "planner.candidates=300".
        seed: seed of garment, start, noise and candidates.
        device: "cpu" or "cuda:0".
        parts: networks shared by several episodes; loaded for this one by default.
        watch: function called after every step.
        progress: function called with every action and its current stage.

    Returns:
        The episode on disk, with its steps and its status.

    Raises:
        InvalidConfigError: `output` holds this episode with other settings, or both a template and
            a garment seed are given.
        InvalidResultError: weights are missing, damaged or of another garment.
    """
    quiet_warp()
    changed = with_settings(config or FlattenConfig(), settings)
    if template is not None:
        changed = replace(changed, perception=replace(changed.perception, template=str(template)))
    episode, robot = SimulatedEpisode(garment, seed, garment_seed=garment_seed), None
    changed = knowing_the_garment(changed, episode.garment, Path(output))
    parts = parts or _parts(garment, changed, device=device)
    if episode.garment is None and changed.perception.template:
        own = replace(vary(garment, seed), size_m=None, garment=changed.perception.template)
        robot = SimulatedRobotConfig(episode=own)
    return flatten_simulated(
        Path(output),
        episode,
        changed,
        robot_config=robot,
        parts=parts,
        device=device,
        watch=watch,
        progress=progress,
    )


def episode_parts(
    garment: GarmentKind,
    config: FlattenConfig,
    *,
    device: str,
    garment_seed: int | None = None,
    output: Path | None = None,
) -> EpisodeParts:
    """Return the parts that episodes of `flatten` can share: networks, or a policy without any."""
    if garment_seed is not None and output is not None:
        config = knowing_the_garment(config, OneGarment(garment, garment_seed), output)
    return _parts(garment, config, device=device)


def _parts(garment: GarmentKind, config: FlattenConfig, *, device: str) -> EpisodeParts:
    parts = shared_parts(garment, config, device=device)
    return replace(parts, propose=POLICIES.get(config.policy))


def plan_flattening(
    recording: Path, output: Path, config: FlattenConfig, *, seed: int, device: str
) -> EpisodeStore:
    """Plan one action for the last picture of a recording and save it; nothing moves."""
    source = read_recording(recording)
    if source.table is None:
        raise InvalidConfigError(f"{recording}: it has no table; flattening needs one")
    # Refuse a picture that cannot be read or shows no cloth, before anything is written.
    seen_area(source, source.frames[-1])
    planned = config.policy == "planned"
    limits = MotionLimits(workspace=config.planner.space.workspace)
    flattening = Flattening(
        DryRunRobot(pictures_of(source), output, limits=limits),
        EpisodeScene(replace(source.cloth, template=None), source.table, flat_area(source.cloth)),
        replace(config, actions=1),
        perception=perception_of(source.cloth.kind, config.perception, device=device)
        if planned
        else None,
        dynamics=dynamics_of(config, device=device) if planned else None,
        propose=POLICIES.get(config.policy),
        seed=seed,
    )
    return flattening.run(output / "episode")


_RANDOM_TRIES = 20
"""Number of random actions that a robot may refuse in a row before a policy gives up."""


def _random_actions(
    seen: SeenCloth, config: PlannerConfig, rng: np.random.Generator
) -> list[PickPlace]:
    """Return random actions from the planner's action space."""
    return sample_actions(seen, _RANDOM_TRIES, config.space, rng)


def _farthest_off_cloth(
    seen: SeenCloth, config: PlannerConfig, rng: np.random.Generator
) -> list[PickPlace]:
    """Return as many actions as the planner tries, those placed farthest off the cloth first."""
    tried = sample_actions(seen, config.candidates, config.space, rng)
    return [tried[k] for k in np.argsort(-off_cloth(seen, tried), kind="stable")]


def _corner_outwards(
    seen: SeenCloth, config: PlannerConfig, rng: np.random.Generator
) -> list[PickPlace]:
    """Return the action of the geometric heuristic (`farthest_corner`), which is not random."""
    del rng
    action = farthest_corner(seen, config.space)
    return [] if action is None else [action]


POLICIES: dict[str, Propose] = {
    "random": _random_actions,
    "outwards": _farthest_off_cloth,
    "heuristic": _corner_outwards,
}
"""Policies without a mesh, by their names in `FlattenConfig.policy`."""


def farthest_corner(seen: SeenCloth, space: ActionSpace) -> PickPlace | None:
    """Return the action that pulls the corner farthest from the middle straight outwards.

    The pull is as long as allowed. Corners are tried from the farthest on until one can be pulled.
    """
    cloud = seen.cloud
    off = cloud[:, :2] - cloud[:, :2].mean(axis=0)
    far = np.linalg.norm(off, axis=1)
    corner = np.argsort(-far * (edge_measure(cloud) > 0.3), kind="stable")
    for point in corner[:: max(1, len(corner) // 100)]:
        for share in (1.0, 0.75, 0.5, 0.25):
            low, high = space.distance_m
            path = (low + share * (high - low)) * off[point] / max(far[point], 1e-9)
            lift = np.array([0.5 * sum(space.lift_m)])
            pick = cloud[point].astype(np.float64)[None]
            allowed = within_limits(seen, pick, pick[:, :2] + path, lift, space)
            if allowed:
                return allowed[0]
    return None
