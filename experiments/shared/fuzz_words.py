"""Command lines that mean nothing good: settings and arguments, drawn at random."""

import inspect
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.tracking import RunConfig
from shared.damage import TEXTS, chosen
from shared.proof_stage import FAST, TOWEL, settings

Words = list[object]

FIRST_WORDS = {"track": "tracker.", "flatten": "planner."}
"""Verbs that list their settings, and where some of them lie."""

DEAR = ("demo", "record", "bench", "flatten", "train-dynamics", "pretrain")
"""Verbs that do something long with any arguments, or wait for a person."""


def setting(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """One or two settings with values that may be none; sometimes the verb runs with them."""
    verb = chosen(("track", "track", "flatten"), rng)
    changes = [_change(verb, rng) for _ in range(int(rng.integers(1, 3)))]
    out, kind = box / "out", rng.random()
    if verb == "track" and kind < 0.4:
        words = ["track", stage / "world" / "recordings" / "towel_0001", "--output", out]
        return [*words, *settings(*FAST, *changes)]
    if kind < 0.6:
        return ["simulate", out, "--actions", 1, *settings(*TOWEL, _simulated(rng))]
    words = [verb, *({"track": [], "flatten": [out]}[verb])]
    return [*words, "--show-settings", *settings(*changes)]


def arguments(rng: np.random.Generator, stage: Path, box: Path) -> Words:
    """A verb with options of its own, each with a value that may be none."""
    from clothtrack.cli import VERBS
    from clothtrack.cli.signature import name_of, options_of

    verb = chosen([verb for verb in VERBS if name_of(verb) not in DEAR], rng)
    words: Words = [name_of(verb)]
    for option in inspect.signature(verb).parameters.values():
        if option.kind is not option.KEYWORD_ONLY and rng.random() < 0.8:
            words.append(_place(rng, stage, box))
    known = sorted(options_of(verb) - {"--live", "--by-hand", "--help", "-h", "--seconds"})
    for _ in range(int(rng.integers(0, 4))):
        words.append(chosen(known, rng) if rng.random() < 0.9 else chosen(TEXTS, rng))
        if rng.random() < 0.8:
            words.append(_place(rng, stage, box) if rng.random() < 0.4 else chosen(TEXTS, rng))
    if rng.random() < 0.5:
        words += ["--output", box / "out" / "result"]
    if name_of(verb) in ("segment", "find-picker", "view"):
        # They may serve a page until somebody comes.
        words += ["--port", "-1"]
    # No word of the command line can hold a NUL, or what is no text.
    return [str(word).replace("\x00", "").replace("\ud800", "") for word in words]


def _place(rng: np.random.Generator, stage: Path, box: Path) -> object:
    """A file or folder that exists, a copy of the case's own, or a word that names none."""
    real = (
        "world/recordings/towel_0001", "tracked/towel_0001.zarr", "labels/towel_0001.labels.npz",
        "bags/ros1.bag", "states", "world", "bags", "", "none",
    )  # fmt: skip
    name = chosen(real, rng)
    if rng.random() >= 0.6:
        return chosen(TEXTS, rng)
    place = box / "in" / name
    if name and (stage / name).is_dir() and not place.exists():
        shutil.copytree(stage / name, place)
    elif (stage / name).is_file() and not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(stage / name, place)
    return place


def _change(verb: str, rng: np.random.Generator) -> str:
    from clothtrack.files.settings import settings_of

    known = list(settings_of(_config(verb)))
    one = chosen(known, rng)
    name = one.name
    if rng.random() < 0.1:
        name = chosen((one.group, name[:-1], name.rpartition(".")[2], *TEXTS[:12]), rng)
    value = chosen(TEXTS, rng)
    if rng.random() < 0.4:
        try:
            number = float(one.value) * float(chosen((-1, 0, 1e-6, 0.1, 3, 1e3, 1e9), rng))
            value = str(int(number) if one.value.isdigit() else number)
        except ValueError:
            pass
    return f"{name}={value}".replace("\x00", "").replace("\ud800", "")


def _config(verb: str) -> Any:
    if verb == "track":
        return RunConfig()
    from clothtrack.planning import FlattenConfig

    return FlattenConfig()


def _simulated(rng: np.random.Generator) -> str:
    from clothtrack.files.settings import settings_of
    from clothtrack_lab.world import SMALL_WORLD

    one = chosen(list(settings_of(SMALL_WORLD)), rng)
    return f"{one.name}={chosen(TEXTS, rng)}".replace("\x00", "").replace("\ud800", "")
