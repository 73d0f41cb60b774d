"""Flatten many times, while other processes do some of the episodes."""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothtrack.files.progress import Progress
from clothtrack.files.shared_work import Executor, Share, attempts, results_of
from clothtrack.files.work_folder import WorkFolder
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.planning.episode_store import DOCUMENT
from clothtrack.simulation.garments import GarmentKind
from clothtrack.world.simulated_episodes import SimulatedEpisode

Row = dict[str, Any]
"""What a program wants to know of an episode."""


def flattened(
    run: Callable[[int, int, int], Row],
    output: Path,
    garment: GarmentKind,
    garment_seed: int | None,
    seeds: Sequence[int],
    *,
    share: Share,
    workers: int = 1,
    progress: Progress | None = None,
    executor: Executor = finished_in_workers,
) -> Generator[Row, None, None]:
    """Run episodes, in the order in which they end; what became of each.

    Args:
        run: flattens with a seed, and writes the report; also gets how many episodes of the share
            come before it, and how many there are. One that is finished it leaves as it is. Other
            processes are sent it, where there are several workers.
        output: folder of the episodes.
        garment: what lies on the table.
        garment_seed: of the one garment, if there is one.
        seeds: of all episodes.
        share: which of them are this process's.
        workers: processes.
        progress: called first, and after each episode.
        executor: who runs the episodes; worker processes by default.

    Raises:
        ClothTrackError: an episode failed; after all others.
    """
    work = _Flattening(run, output, garment, garment_seed, tuple(share.of(seeds)))
    folder = WorkFolder(output, "flatten")
    shared = attempts(
        work, seeds, folder, kind="episodes", processes=workers, share=share, progress=progress,
        executor=executor,
    )  # fmt: skip
    with closing(shared) as tries:
        for _, row in results_of(tries):
            yield row


@dataclass(frozen=True)
class _Flattening:
    """Flatten with a seed, as `clothtrack.files.shared_work.Work`."""

    run: Callable[[int, int, int], Row]
    output: Path
    garment: GarmentKind
    garment_seed: int | None
    seeds: tuple[int, ...]

    def name(self, seed: int) -> str:
        """The name of the episode."""
        return SimulatedEpisode(self.garment, seed, garment_seed=self.garment_seed).label

    def paths(self, seed: int) -> list[Path]:
        """The recording, the truth, and the report, which comes last."""
        name = self.name(seed)
        return [
            self.output / "recordings" / name,
            self.output / "truth" / f"{name}.npz",
            self.output / f"{name}.html",
        ]

    def kept(self, seed: int) -> Row | None:
        """What became of an episode that has ended; `run` opens it, and plays no more."""
        document = self.output / "episodes" / self.name(seed) / DOCUMENT
        if not (document.is_file() and self.paths(seed)[-1].is_file()):
            return None
        ended = '"status": "running"' not in document.read_text("utf-8", errors="replace")
        return self.do(seed) if ended else None

    def do(self, seed: int) -> Row:
        """Begin the episode, or go on with it."""
        return self.run(seed, self.seeds.index(seed), len(self.seeds))
