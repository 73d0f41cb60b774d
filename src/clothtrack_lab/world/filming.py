"""Recording of many trajectories in the simulated world."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from clothtrack.errors import InvalidConfigError, SimulationDivergedError
from clothtrack.files.many_items import Attempt, attempts, results_of
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.files.worker_pool import require_workers
from clothtrack.garments.garment_meshes import GarmentKind
from clothtrack_lab.world.episodes import EpisodeConfig, recording_name, simulate_trajectory
from clothtrack_lab.world.template_mesh import GivenGarment

logger = logging.getLogger(__name__)


def simulate(
    out: Path,
    kind: GarmentKind,
    trajectories: int,
    *,
    seed: int = 0,
    config: EpisodeConfig | None = None,
    garment: GivenGarment | None = None,
    processes: int = 1,
    progress: Progress | None = None,
    ray: str = "",
) -> list[Path]:
    """Record several trajectories, with the seeds `seed`, `seed` + 1 and so on.

    Existing recordings are left unchanged, so an interrupted run can be resumed. Trajectories whose
    physics diverges are logged and left out.
    """
    require_workers(processes)
    if trajectories < 1:
        raise InvalidConfigError(f"the number of trajectories is {trajectories}; give at least 1")
    filming = _Filming(Path(out), kind, config or EpisodeConfig(), garment)
    recorded = attempts(
        filming, range(seed, seed + trajectories), kind="recordings", workers=processes, ray=ray,
        progress=progress,
    )  # fmt: skip
    with locked_output(out), closing(recorded) as tries:
        folders = dict(results_of(_without_diverged(tries, filming)))
    return [folders[each] for each in sorted(folders)]


def _without_diverged(
    tries: Iterable[Attempt[int, Path]], filming: "_Filming"
) -> Iterator[Attempt[int, Path]]:
    for one in tries:
        if isinstance(one.error, SimulationDivergedError):
            logger.warning("%s left out: %s", filming.name(one.item), one.error)
        else:
            yield one


@dataclass(frozen=True)
class _Filming:
    """Recording of one seed per item, as `clothtrack.files.many_items.Work`."""

    out: Path
    kind: GarmentKind
    config: EpisodeConfig
    garment: GivenGarment | None

    def name(self, seed: int) -> str:
        """Return the name of the recording."""
        return recording_name(self.kind, seed, self.garment)

    def paths(self, seed: int) -> list[Path]:
        """Return truth and recording; the recording is written last."""
        return [
            self.out / "truth" / f"{self.name(seed)}.npz",
            self.out / "recordings" / self.name(seed),
        ]

    def kept(self, seed: int) -> Path | None:
        """Return the existing recording."""
        folder = self.out / "recordings" / self.name(seed)
        return folder if folder.exists() else None

    def do(self, seed: int) -> Path:
        """Record it."""
        return simulate_trajectory(
            self.kind, seed, self.out, config=self.config, garment=self.garment
        )
