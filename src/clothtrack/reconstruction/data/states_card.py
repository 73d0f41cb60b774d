"""The dataset card of a folder of states, written from the content of its shards."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from clothtrack.reconstruction.data.crumpling import REST_SPEED
from clothtrack.reconstruction.data.state_store import StateSet, StateShard, read_shard

BINS = np.linspace(0.0, 1.1, 12)
"""Bounds of the histogram of coverage."""

_BAR = 40
"""Length of the longest bar of the histogram, in characters."""


def dataset_card(states: StateSet) -> str:
    """Return the card of a folder of states: counts, recipes, sizes, quality and cost."""
    shards = [read_shard(path) for path in states.shards]
    document = states.document
    parts = [
        f"# Crumpled states: {states.kind}",
        _counts(shards, document),
        _recipes(shards),
        _soundness(shards),
        _coverage(shards),
        _cost(document),
        _origin(document),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _measure(shards: list[StateShard], name: str) -> np.ndarray:
    values = [shard.measures[name] for shard in shards if name in shard.measures]
    return np.concatenate(values) if values else np.empty(0)


def _counts(shards: list[StateShard], document: Mapping[str, Any]) -> str:
    states = sum(len(shard.positions) for shard in shards)
    episodes = sum(len(np.unique(shard.episodes)) for shard in shards)
    vertices = [shard.mesh.vertex_count for shard in shards]
    sizes = np.array([np.ptp(shard.mesh.vertices[:, :2], axis=0) for shard in shards])
    (low_x, low_y), (high_x, high_y) = sizes.min(axis=0), sizes.max(axis=0)
    seed = f" Seed {document['seed']}." if "seed" in document else ""
    return (
        f"{states} states in {episodes} episodes of {len(shards)} garments "
        f"({min(vertices)} to {max(vertices)} vertices; {100 * low_x:.1f} to {100 * high_x:.1f} cm "
        f"wide, {100 * low_y:.1f} to {100 * high_y:.1f} cm long).{seed}\n"
        "Positions are in meters, z up, the table at z = 0. Split by `episodes` or by shard, never "
        "by state."
    )


def _recipes(shards: list[StateShard]) -> str:
    counted = Counter(recipe for shard in shards for recipe in shard.recipes)
    total = sum(counted.values())
    rows = [
        f"| {name} | {count} | {100 * count / total:.1f} % |"
        for name, count in counted.most_common()
    ]
    return "\n".join(["| recipe | states | share |", "|---|---|---|", *rows])


def _soundness(shards: list[StateShard]) -> str:
    speed, strain = _measure(shards, "speed"), _measure(shards, "strain")
    if not len(speed):
        return ""
    edges = np.repeat(
        [len(shard.mesh.edges) for shard in shards], [len(shard.positions) for shard in shards]
    )
    crossed = 1000.0 * _measure(shards, "crossings") / edges

    def row(name: str, values: np.ndarray, digits: int) -> str:
        numbers = [np.median(values), values.mean(), np.percentile(values, 90), values.max()]
        return f"| {name} | " + " | ".join(f"{x:.{digits}f}" for x in numbers) + " |"

    return "\n".join(
        [
            f"Settled: {100 * np.mean(speed < REST_SPEED):.1f} % of states: in the tenth of a "
            f"second before it was taken no vertex covered more way than {REST_SPEED} m/s do. The "
            "others still moved when the wait ended.",
            "",
            "| | median | mean | 90 % below | highest |",
            "|---|---|---|---|---|",
            row("speed of the fastest vertex [m/s]", speed, 3),
            row("edge strain [%]", 100.0 * strain, 2),
            row("crossing edges per 1,000", crossed, 1),
        ]
    )


def _coverage(shards: list[StateShard]) -> str:
    coverage = _measure(shards, "coverage")
    if not len(coverage):
        return ""
    counts, _ = np.histogram(np.clip(coverage, BINS[0], BINS[-1]), BINS)
    lines = [
        f"    {low:.1f} to {high:.1f}  {count:6d}  {'#' * round(_BAR * count / counts.max())}"
        for low, high, count in zip(BINS, BINS[1:], counts, strict=False)
    ]
    return "Coverage (projected area over that of the flat garment), states:\n\n" + "\n".join(lines)


def _cost(document: Mapping[str, Any]) -> str:
    entries = [one for one in document.get("shards", {}).values() if one["cpu_s"]]
    if not entries:
        return ""
    states, cpu_s = (sum(one[name] for one in entries) for name in ("states", "cpu_s"))
    return (
        f"Made in {cpu_s:.0f} s of CPU time, garments, measures and writing included: "
        f"{3600.0 * states / cpu_s:,.0f} states per CPU-hour."
    )


def _origin(document: Mapping[str, Any]) -> str:
    provenance = document.get("provenance", {})
    lines = [f"- {name}: {value}" for name, value in provenance.items()]
    return "\n".join(["Made with:", "", *lines]) if lines else ""
