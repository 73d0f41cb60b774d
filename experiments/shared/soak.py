"""Soak test: whether one process that tracks many recordings grows, slows or keeps files open."""

import resource
import shutil
import statistics
import threading
import time
from pathlib import Path

from shared.proof_stage import FAST, settings
from shared.trial import child_result

WARM = 3
"""Items after which the process has what it needs."""

MOST_GROWTH_MB, MOST_SLOWER = 30.0, 2.0


def rows(count: int, seed: int, stage: Path, box: Path) -> list[dict]:
    """Track as many copies of one recording in one process; a row after each."""
    place = box / "soak"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    measured = child_result(lambda: {"rows": _tracked(count, stage, place)}, box)["rows"]
    shutil.rmtree(place)
    return [{"case": number, "seed": seed, **row} for number, row in enumerate(measured)]


def case(number: int, seed: int, stage: Path, box: Path) -> dict:
    """Return the row after so many trajectories."""
    return rows(number + 1, seed, stage, box)[-1]


def _tracked(count: int, stage: Path, place: Path) -> list[dict]:
    from clothtrack.cli import main

    source = stage / "world" / "recordings" / "towel_0001"
    measured: list[dict] = []
    for number in range(count):
        folder = shutil.copytree(source, place / f"towel_{number:04d}")
        start = time.process_time()
        words = ["track", folder, "--output", place / "out", *settings(*FAST)]
        code = main([str(word) for word in words])
        spent = time.process_time() - start
        shutil.rmtree(folder)
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
        measured.append({
            "code": code, "cpu_s": round(spent, 3),
            "rss_mb": round(pages * resource.getpagesize() / 2**20, 1),
            "files": len(list(Path("/proc/self/fd").iterdir())),
            "threads": threading.active_count(),
        })  # fmt: skip
        first = measured[min(WARM, number)]
        usual = statistics.median(row["cpu_s"] for row in measured)
        measured[-1]["grown_mb"] = round(measured[-1]["rss_mb"] - first["rss_mb"], 1)
        measured[-1]["more_files"] = measured[-1]["files"] - first["files"]
        measured[-1]["slower"] = round(spent / usual, 2)
    return measured


def violates(row: dict) -> bool:
    """Return whether the process grew, or kept something open, since it was warm."""
    return row["code"] != 0 or row["grown_mb"] > MOST_GROWTH_MB or row["more_files"] > WARM


def markdown(measured: list[dict]) -> str:
    """Return the process at a few moments."""
    lines = ["| trajectories | memory | CPU time of all | open files | threads |",
             "|---:|---:|---:|---:|---:|"]  # fmt: skip
    total = 0.0
    shown = {1, 2, WARM + 1, len(measured) // 4, len(measured) // 2, len(measured)}
    for number, row in enumerate(measured, 1):
        total += row["cpu_s"]
        if number in shown:
            lines.append(f"| {number} | {row['rss_mb']:.0f} MB | {total:.1f} s | {row['files']} | "
                         f"{row['threads']} |")  # fmt: skip
    late = measured[WARM:] or measured
    half = len(late) // 2
    if half:
        before, after = (statistics.median(row["cpu_s"] for row in part)
                         for part in (late[:half], late[half:]))  # fmt: skip
        lines += ["", f"CPU time of one, median: {before:.2f} s in the first half, {after:.2f} s "
                  "in the second."]  # fmt: skip
    return "\n".join(lines) + "\n"
