"""Flattening of many episodes in the simulated world, each with a report and a summary."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from clothtrack.files.many_items import attempts, results_of
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress, one_of
from clothtrack.garments.garment_meshes import GarmentKind
from clothtrack.planning.episode_store import DOCUMENT, EpisodeStore
from clothtrack.planning.flatten_config import FlattenConfig
from clothtrack.planning.flattening import Watch, improvement
from clothtrack.report.flattening_page import write_flattening_report
from clothtrack_lab.flattening import flatten
from clothtrack_lab.world.simulated_episodes import EpisodeParts, SimulatedEpisode

Row = dict[str, Any]
"""Summary of an episode for programs."""


def run_episodes(
    output: Path,
    garment: GarmentKind,
    config: FlattenConfig,
    seeds: Sequence[int],
    *,
    garment_seed: int | None = None,
    device: str = "cpu",
    parts: EpisodeParts | None = None,
    watch: Watch | None = None,
    workers: int = 1,
    ray: str = "",
    progress: Progress | None = None,
) -> Generator[Row, None, None]:
    """Run episodes and summarize each as it ends; finished ones are kept."""
    work = _Flattening(Path(output), garment, config, tuple(seeds), garment_seed, device)
    if alone := workers == 1 and not ray:
        work = replace(work, parts=parts, watch=watch, progress=progress)
    flattened = attempts(
        work, seeds, kind="episodes", workers=workers, ray=ray, device=device,
        progress=None if alone else progress,
    )  # fmt: skip
    with locked_output(output), closing(flattened) as tries:
        for _, row in results_of(tries):
            yield row


@dataclass(frozen=True)
class _Flattening:
    """Flattening with one seed per item, as `clothtrack.files.many_items.Work`."""

    output: Path
    garment: GarmentKind
    config: FlattenConfig
    seeds: tuple[int, ...]
    garment_seed: int | None
    device: str
    parts: EpisodeParts | None = None
    watch: Watch | None = None
    progress: Progress | None = None

    def name(self, seed: int) -> str:
        """Return the name of the episode."""
        return SimulatedEpisode(self.garment, seed, garment_seed=self.garment_seed).label

    def paths(self, seed: int) -> list[Path]:
        """Return recording, truth and report; the report is written last."""
        name = self.name(seed)
        return [
            self.output / "recordings" / name,
            self.output / "truth" / f"{name}.npz",
            self.output / f"{name}.html",
        ]

    def kept(self, seed: int) -> Row | None:
        """Return the summary of an episode that has ended."""
        document = self.output / "episodes" / self.name(seed) / DOCUMENT
        if not (document.is_file() and self.paths(seed)[-1].is_file()):
            return None
        ended = '"status": "running"' not in document.read_text("utf-8", errors="replace")
        return self.do(seed) if ended else None

    def do(self, seed: int) -> Row:
        """Start or resume the episode; one that has ended is only opened."""
        told = one_of(self.progress, self.seeds.index(seed), len(self.seeds), "episode")
        store = flatten(
            self.output, self.garment, garment_seed=self.garment_seed, config=self.config,
            seed=seed, device=self.device, parts=self.parts, watch=self.watch, progress=told,
        )  # fmt: skip
        return _summary(store, self.output)


def _summary(store: EpisodeStore, output: Path) -> Row:
    """Write the report of an episode and summarize it; controls are marked as such."""
    page = write_flattening_report(store, output / f"{store.folder.name}.html")
    return {
        "episode": str(store.folder),
        "status": store.document["status"],
        "actions": len(store.steps) - 1,
        **store.document["asked"]["label"],
        "improvement": improvement(store.steps),
        "report": str(page),
    }
