"""Record in the simulated world, make the benchmark, or crumple garments for training."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from clothtrack.api.options import Garment, Ray, Settings
from clothtrack.api.results import Result
from clothtrack.errors import InvalidConfigError, WrongUsageError
from clothtrack_lab.extra import require_lab

if TYPE_CHECKING:
    from clothtrack.files.progress import Progress


@dataclass(frozen=True)
class Simulated(Result):
    """The output of a simulation.

    Attributes:
        folders: folders of the recordings, or of the shards of states.
    """

    folders: tuple[Path, ...] = ()

    def __iter__(self) -> Iterator[Path]:
        """Iterate over the folders."""
        return iter(self.folders)


def simulate(
    output: Path | str,
    garment: Garment = "towel",
    trajectories: int | None = None,
    *,
    actions: int | None = None,
    template: Path | str | None = None,
    garment_seed: int | None = None,
    small: bool = False,
    states: int | None = None,
    benchmark: Literal["all", "dev", "test", "hard"] | None = None,
    printed: Annotated[bool, arg(name="print")] = False,
    settings: Settings = (),
    workers: int = 1,
    ray: Ray = "",
    seed: int = 0,
    progress: "Progress | None" = None,
) -> Simulated:
    """Record in a simulated world, or, with --states, crumple garments for training a network.

    Args:
        output: folder for recordings/ and truth/, or shards/; finished items are kept.
        garment: kind of garment on the table; trousers only with --states.
        trajectories: number of recordings, 1 by default, with the seeds SEED, SEED + 1, ...
        actions: pick-and-places per recording, 3 by default.
        template: mesh of this garment (`clothtrack garment`), with one layer for a towel and two
            for a tshirt.
        garment_seed: use one garment and one camera for all recordings, with a cut, size and
            thickness that no shipped network was trained on; the recordings are named
            KIND_gNNNN_SEED.
        small: record one action with a napkin and a small camera, in a few seconds.
        states: record nothing, and make at least this many labeled states with our own solver.
        benchmark: record the benchmark or a part of it: 20 trajectories for tuning (dev), 30 for
            scoring (test), 10 hard ones. It has its own garments and seeds.
        printed: record the benchmark with a print on the cloth, in a separate folder.
        settings: changes to the configuration, such as sensor.width=320 or vertex_count=300.
        workers: number of processes.
        ray: address of the Ray cluster to run on; 'local' for this machine.
        seed: seed of garment, pose, actions, camera and noise.
        progress: function called at the start and after each recording.

    Returns:
        The output; iterating over it gives the folders of the recordings.

    Raises:
        InvalidConfigError: the options contradict each other, or a setting is unknown.
    """
    output = Path(output)
    if seed < 0:
        raise InvalidConfigError(f"the seed is {seed}; it must be at least 0")
    given = {
        "garment_seed": garment_seed, "template": template, "trajectories": trajectories,
        "actions": actions, "small": small or None, "states": states,
        "settings": settings or None, "benchmark": benchmark, "print": printed or None,
    }  # fmt: skip
    if states is not None:
        _refuse(given, ("states", "settings"), "--states records nothing")
        return _crumple(
            output, garment, states, settings, seed=seed, workers=workers, ray=ray,
            progress=progress,
        )  # fmt: skip
    if benchmark is not None:
        other = {"garment": garment if garment != "towel" else None, "seed": seed or None}
        _refuse(given | other, ("benchmark", "print"), "the benchmark is always the same")
        return _benchmark(
            output, benchmark, printed=printed, workers=workers, ray=ray, progress=progress
        )
    _refuse({"print": printed or None}, (), "only the benchmark is printed")
    if garment == "trousers":
        raise WrongUsageError(
            "trousers are not recorded; add --states, or give a towel or a tshirt"
        )
    if garment_seed is not None and (template is not None or small):
        raise InvalidConfigError(
            "garment_seed draws a garment of its own cut and size; leave "
            f"{'template' if template is not None else 'small'} out"
        )
    require_lab()
    from clothtrack_lab.world.filming import simulate as film_many

    count = 1 if trajectories is None else trajectories
    config, one = _world(garment, template, garment_seed, small=small)
    from clothtrack.files.settings import with_settings
    from clothtrack.geometry.devices import quiet_warp

    quiet_warp()
    counted = () if actions is None else (f"actions={actions}",)
    folders = film_many(
        output, garment, count, seed=seed, config=with_settings(config, [*counted, *settings]),
        garment=one, processes=workers, progress=progress, ray=ray,
    )  # fmt: skip
    enough = len(folders) == count
    words = "\n".join(map(str, folders))
    return Simulated(words, folders, exit_code=0 if enough else 1, folders=tuple(folders))


def _world(
    garment: Literal["towel", "tshirt"],
    template: Path | str | None,
    garment_seed: int | None,
    *,
    small: bool,
) -> tuple[Any, Any]:
    """Return the episode configuration, and the single garment, if there is one."""
    from dataclasses import replace

    from clothtrack_lab.world.episodes import SMALL_WORLD, EpisodeConfig
    from clothtrack_lab.world.one_garment import OneGarment

    if garment_seed is not None:
        one = OneGarment(garment, garment_seed)
        return one.config, one
    config = SMALL_WORLD if small else EpisodeConfig()
    return config if template is None else replace(config, size_m=None, garment=str(template)), None


def _crumple(
    output: Path,
    garment: Garment,
    states: int,
    settings: Sequence[str],
    *,
    seed: int,
    workers: int,
    ray: str,
    progress: "Progress | None",
) -> Simulated:
    """Make labeled states with our own solver."""
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.data.states import StatesConfig, generate_states

    store = generate_states(
        output, garment, states, seed=seed, config=with_settings(StatesConfig(), settings),
        processes=workers, progress=progress, ray=ray,
    )  # fmt: skip
    garments = len(store.shards)
    states = sum(entry["states"] for entry in store.document["shards"].values())
    report = {"states": store.folder, "garments": garments}
    told = f"{store.folder}   ({states} states of {garments} garments)"
    return Simulated(told, report, folders=tuple(store.shards))


def _benchmark(
    output: Path,
    split: Literal["all", "dev", "test", "hard"],
    *,
    printed: bool,
    workers: int,
    ray: str,
    progress: "Progress | None",
) -> Simulated:
    """Make the benchmark or a part of it."""
    require_lab()
    from clothtrack_lab.world import bench as contents
    from clothtrack_lab.world import bench_generation as generation

    splits = contents.SPLITS if split == "all" else (split,)
    listed = contents.trajectories(splits, printed=printed)
    entries = generation.generate_bench(
        output, listed, processes=workers, progress=progress, ray=ray
    )
    folders = tuple(output / "recordings" / one.name for one in listed)
    return Simulated(generation.table(entries), entries, folders=folders)


def _refuse(given: dict[str, Any], meant: tuple[str, ...], why: str) -> None:
    """Refuse options that have no effect, instead of ignoring them silently."""
    wrong = [name for name, value in given.items() if value is not None and name not in meant]
    if wrong:
        names = " and ".join(f"--{name.replace('_', '-')}" for name in wrong)
        raise WrongUsageError(f"{why}; leave {names} out")
