"""Seeded damage to every kind of input: refused in one line, accepted, or a violation."""

import json
import os
import shutil
import tempfile
import warnings
from pathlib import Path

import numpy as np

from shared import fuzz_inputs, fuzz_words
from shared.damage import LONG
from shared.trial import CRASHED, MOST_CPU_S, MOST_MEMORY, Limits, Trial, run

KINDS = {
    "recordings": fuzz_inputs.recording,
    "trajectories (.zarr)": fuzz_inputs.trajectory,
    "labels, truth, worlds (.npz)": fuzz_inputs.labels,
    "weights": fuzz_inputs.weights,
    "meshes": fuzz_inputs.mesh,
    "lists, reviews, states, lenses, poses": fuzz_inputs.other_files,
    "bags, folders to import": fuzz_inputs.imported,
    "settings": fuzz_words.setting,
    "arguments": fuzz_words.arguments,
}

ECHO = 300
"""Most characters of a value that a message repeats."""

LONGEST_LINE = 1000

SILENT = ("inspect",)
"""Verbs that say on standard output what is wrong."""


def case(number: int, seed: int, stage: Path, box: Path) -> dict:
    """Damage one input and have a verb read it; a row with the outcome.

    Args:
        number: number of the case; kinds take turns.
        seed: seed of the proof.
        stage: folder of the small world, which is read-only.
        box: folder of cases.
    """
    kind = list(KINDS)[number % len(KINDS)]
    place = box / "case"
    shutil.rmtree(place, ignore_errors=True)
    for name in ("in", "out", "tmp"):
        (place / name).mkdir(parents=True)

    def words() -> list[object]:
        rng = np.random.default_rng([seed, number])
        # Whoever seals odd arrays is warned; what is judged comes later.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made = [str(word) for word in KINDS[kind](rng, stage, place)]
        (place / "words.json").write_text(json.dumps(made))
        os.chdir(place / "out")
        os.environ["TMPDIR"] = tempfile.tempdir = str(place / "tmp")
        return made

    # What a verb changes on purpose lies in the case's own input.
    trial = run(words, place, limits=Limits(folder=place))
    made = place / "words.json"
    said = json.loads(made.read_text()) if made.exists() else ["(the case was not made)"]
    row = {"kind": kind, "verb": said[0], "outcome": outcome(trial, said[0]),
           "cpu_s": round(trial.cpu_s, 2), "peak_mb": trial.peak_bytes >> 20}  # fmt: skip
    if violates(row):
        row["words"] = [word[:200] for word in said]
        row["code"] = trial.code
        row["said"] = [line[:1000] for line in trial.complaints[-12:]]
    shutil.rmtree(place, ignore_errors=True)
    return row


def outcome(trial: Trial, verb: str) -> str:
    """Return the outcome of a case: "accepted", "refused", or what is wrong with it."""
    text, count = "\n".join(trial.complaints), len(trial.complaints)
    longest = max(map(len, trial.complaints), default=0)
    silent_least = 0 if verb in SILENT else 1
    found = (
        ("traceback", "Traceback" in text or trial.code == CRASHED),
        ("hangs", trial.cpu_s > MOST_CPU_S),
        (f"ended by signal {-trial.code}", trial.code < 0),
        ("too much memory", trial.peak_bytes > MOST_MEMORY),
        ("warning", "Warning" in text),
        ("long echo", LONG[:ECHO] in text or longest >= LONGEST_LINE),
        (f"writes outside: {(*trial.outside, '')[0]}", bool(trial.outside)),
        ("accepted", trial.code == 0),
        (f"exit code {trial.code}", trial.code not in (1, 2)),
        ("silent", count < silent_least),
        (f"{count} lines", count > 1),
    )
    return next((name for name, holds in found if holds), "refused")


def violates(row: dict) -> bool:
    """Return whether a case shows a defect."""
    return row["outcome"] not in ("accepted", "refused")


def markdown(rows: list[dict]) -> str:
    """Return a line per kind of input."""
    lines = [
        "| input | cases | refused in one line | accepted | violations | slowest | most memory |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for kind in (*KINDS, "all"):
        mine = [row for row in rows if kind in ("all", row["kind"])]
        if mine:
            refused = sum(row["outcome"] == "refused" for row in mine)
            accepted = sum(row["outcome"] == "accepted" for row in mine)
            lines.append(
                f"| {kind} | {len(mine)} | {refused} | {accepted} | "
                f"{sum(map(violates, mine))} | {max(row['cpu_s'] for row in mine):.1f} s | "
                f"{max(row['peak_mb'] for row in mine)} MB |"
            )
    return "\n".join(lines) + "\n"
