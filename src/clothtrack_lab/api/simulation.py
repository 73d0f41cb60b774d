"""Record in the simulated world, make the benchmark, or crumple garments to learn from."""

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
    """What was simulated.

    Attributes:
        folders: of the recordings, or of the shards of states.
    """

    folders: tuple[Path, ...] = ()

    def __iter__(self) -> Iterator[Path]:
        """Give the folders."""
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
    """Record in a simulated world; or, with --states, crumple garments for a network to learn from.

    Args:
        output: folder for recordings/ and truth/, or shards/; what is finished there is kept.
        garment: what lies on the table; trousers only with --states.
        trajectories: how many recordings, 1 by default; they get the seeds SEED, SEED + 1, ...
        actions: pick-and-places per recording, 3 by default.
        template: the garment's own mesh (`clothtrack garment`), of one layer for a towel, of two
            for a tshirt.
        garment_seed: one garment for all recordings, before one camera, of a cut, size and
            thickness that no shipped network was trained on; its recordings are KIND_gNNNN_SEED.
        small: one action with a napkin before a small camera, in a few seconds.
        states: record nothing; make at least so many labeled states with our own solver.
        benchmark: record the benchmark, or a part: 20 trajectories to tune on (dev), 30 to score
            (test), 10 hard ones. It has its own garments and seeds.
        printed: the benchmark with a print on the cloth, in a folder of its own.
        settings: changes to what is recorded, such as sensor.width=320 or vertex_count=300.
        workers: processes.
        ray: address of Ray, which is to do it; 'local' for this machine.
        seed: of garment, pose, actions, camera and noise.
        progress: called first, and after each recording.

    Returns:
        What was made; iterating over it gives the folders of the recordings.

    Raises:
        InvalidConfigError: what is asked for excludes itself, or a setting is not known.
    """
    output = Path(output)
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
        _refuse(given, ("benchmark", "print"), "the benchmark is always the same")
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
    """What is recorded, and the one garment, if there is one."""
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
    """Labeled states, by our own solver."""
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.data.states import StatesConfig, generate_states

    store = generate_states(
        output, garment, states, seed=seed, config=with_settings(StatesConfig(), settings),
        processes=workers, progress=progress, ray=ray,
    )  # fmt: skip
    card, garments = store.folder / "README.md", len(store.shards)
    report = {"states": store.folder, "card": card, "garments": garments}
    return Simulated(f"{card}   ({garments} garments)", report, folders=tuple(store.shards))


def _benchmark(
    output: Path,
    split: Literal["all", "dev", "test", "hard"],
    *,
    printed: bool,
    workers: int,
    ray: str,
    progress: "Progress | None",
) -> Simulated:
    """The benchmark, or a part of it."""
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
    """Refuse what would mean nothing, rather than leave it out silently."""
    wrong = [name for name, value in given.items() if value is not None and name not in meant]
    if wrong:
        names = " and ".join(f"--{name.replace('_', '-')}" for name in wrong)
        raise WrongUsageError(f"{why}; leave {names} out")
