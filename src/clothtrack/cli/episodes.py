"""Episodes of `flatten`: each with its report and a line, whoever plays it."""

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import clothtrack as ct
from clothtrack.cli.terminal import progress, say
from clothtrack.files.progress import one_of

if TYPE_CHECKING:
    from clothtrack.files.shared_work import Executor, Share
    from clothtrack.planning.episode_store import EpisodeStore
    from clothtrack.planning.flatten_config import FlattenConfig
    from clothtrack.planning.flattening import Watch
    from clothtrack.world.simulated_episodes import EpisodeParts


def played(
    output: Path,
    garment: Literal["towel", "tshirt"],
    config: "FlattenConfig",
    seeds: Sequence[int],
    *,
    share: "Share",
    garment_seed: int | None,
    device: str,
    parts: "EpisodeParts",
    watch: "Watch | None",
    workers: int,
    executor: "Executor",
    here: bool,
    json: bool,
) -> list[dict[str, Any]]:
    """Play episodes, saying a line of each; what a program wants to know of them.

    Args:
        output: folder of the episodes.
        garment: what lies on the table.
        config: how it is flattened.
        seeds: of all episodes.
        share: which of them are this process's.
        garment_seed: of the one garment, if there is one.
        device: where to compute.
        parts: networks, for episodes that this process plays; others read their own.
        watch: is shown every step; of this process only.
        workers: processes.
        executor: who runs them.
        here: this process plays the episodes itself.
        json: say nothing.
    """
    from clothtrack.front.many_episodes import flattened

    run = partial(
        _flatten_one, output, garment, config=config, garment_seed=garment_seed, device=device,
        parts=parts if here else None, watch=watch,
    )  # fmt: skip
    shared = flattened(
        run, output, garment, garment_seed, seeds, share=share, workers=workers,
        progress=None if here else progress, executor=executor,
    )  # fmt: skip
    rows = []
    with closing(shared) as results:
        for row in results:
            rows.append(row)
            if not json:
                say(_in_words(row))
    return rows


def _flatten_one(
    output: Path,
    garment: Literal["towel", "tshirt"],
    seed: int,
    number: int,
    count: int,
    **options: Any,
) -> dict[str, Any]:
    """Flatten with a seed, `number` episodes of `count` being done, and write the report."""
    told = one_of(progress, number, count, "episode")
    store = ct.flatten(output, garment, seed=seed, progress=told, **options)
    return _summary(store, output)


def _in_words(row: dict[str, Any]) -> str:
    """A summary in a line."""
    control = "   CONTROL" if row["control"] else ""
    return (
        f"{row['report']}   improvement {row['improvement'][-1]:.2f} after {row['actions']} "
        f"actions; {row['status']}{control}"
    )


def _summary(store: "EpisodeStore", output: Path) -> dict[str, Any]:
    """Write the report of an episode; what a program wants to know of it. Controls say so."""
    from clothtrack.planning.flattening import improvement
    from clothtrack.report.flattening_page import write_flattening_report

    page = write_flattening_report(store, output / f"{store.folder.name}.html")
    return {
        "episode": str(store.folder),
        "status": store.document["status"],
        "actions": len(store.steps) - 1,
        **store.document["asked"]["label"],
        "improvement": improvement(store.steps),
        "report": str(page),
    }
