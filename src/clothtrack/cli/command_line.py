"""The command line: one verb per stage, in the order of the method.

A verb is a public function of `clothtrack`, `clothtrack_capture` or `clothtrack_lab`. The command
line parses its arguments (`cli.signature`), calls it and prints the result: its `text()`, or its
`as_dict()` with --json. The `doubts` of the result go to standard error, one line each, and its
`exit_code` becomes that of the process. The stages are imported when their verb is called, so that
`--help` is fast. Exit codes: 0 success, 1 bad input or a full disk (one line on standard error),
2 wrong usage (also one line), 130 interrupt.
"""

import inspect
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import entry_points
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import clothtrack
from clothtrack.cli.signature import configuration_of
from clothtrack.cli.terminal import (
    INTERRUPTED,
    complain,
    end_by_interrupt,
    exit_code,
    progress,
    say,
    say_result,
)
from clothtrack.cli.usage import Function, overview, parse
from clothtrack.cli.warnings_once import logged
from clothtrack.errors import InvalidConfigError

OWN: Mapping[str, str] = {
    "demo": "demo",
    "inspect": "inspect_many",
    "garment": "garment_template",
    "track": "track_many",
    "live": "play_live",
    "label": "label_many",
    "pretrain": "pretrain",
    "finetune": "finetune",
    "reconstruct": "reconstruct",
    "evaluate": "evaluate_many",
    "view": "view",
    "export": "export",
}
"""The verbs of the core package, and the `clothtrack` functions that implement them."""

VERBS: Mapping[str, Callable[[], Function]] = {
    **{verb: partial(getattr, clothtrack, name) for verb, name in OWN.items()},
    **{found.name: found.load for found in entry_points(group="clothtrack.verbs")},
}
"""A loader for the function of each verb; other packages register verbs as entry points."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    "the main path": ("demo", "import", "track", "live", "evaluate", "view", "live-ros2"),
    "recordings": (
        "inspect", "record", "calibrate-camera", "segment", "find-picker", "garment",
    ),
    "learning": ("reconstruct", "label", "finetune", "pretrain"),
    "results": ("export",),
    "the simulated world": ("simulate", "flatten"),
}  # fmt: skip
"""The order of `--help`; a verb that is in no group comes last."""

_PACKAGES = (
    "warp-lang", "numpy", "scipy", "opencv-python-headless", "zarr", "mujoco-core", "tyro", "torch",
)  # fmt: skip
"""Distributions that results depend on; those of an extra are listed if installed."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that numeric libraries read when they are loaded. The operations here are
small, so that threads mostly wait for each other: on a busy machine, several times as long."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    code = exit_code(lambda: _begin(words))
    if code == INTERRUPTED and arguments is None:
        end_by_interrupt()
    return code


def _begin(words: Sequence[str]) -> int:
    """Run the requested verb and return the exit code."""
    if words[:1] == ["--version"]:
        return _versions(json="--json" in words)
    if words[:1] in (["-h"], ["--help"]):
        say(overview(VERBS, GROUPS))
        return 0
    for word in words:
        if not word.isprintable() and any("\udc80" <= letter <= "\udcff" for letter in word):
            raise InvalidConfigError(f"{word!r}: the name is not UTF-8, as results need; rename it")
    function, chosen = parse(words, VERBS)
    for variable in _THREADS:
        os.environ.setdefault(variable, "1")
    with logged(verbose=chosen.pop("verbose")):
        return _run(words[0], function, chosen)


def _versions(*, json: bool) -> int:
    """Print the version, commit, devices, machine and packages; no package is imported."""
    from clothtrack.files.provenance import made_with
    from clothtrack.geometry.devices import device_names, quiet_warp

    quiet_warp()
    made, devices = made_with(_PACKAGES), device_names()
    commit = f" (commit {made['commit']})" if made["commit"] else ""
    installed = made["packages"]
    assert isinstance(installed, dict)
    lines = [
        f"clothtrack {made['clothtrack']}{commit}",
        f"devices   {', '.join(devices)}",
        f"machine   {made['machine']}, Python {made['python']}",
        f"packages  {', '.join(f'{name} {version}' for name, version in installed.items())}",
    ]
    say_result("\n".join(lines), {**made, "devices": devices}, json=json)
    return 0


def _run(verb: str, function: Function, chosen: dict[str, Any]) -> int:
    """Call the function of a verb, print its result and return the exit code."""
    from clothtrack.geometry.devices import quiet_warp

    # Warp would print a banner to standard output, where the results go.
    quiet_warp()
    json = chosen.pop("json")
    if chosen.pop("show_settings", False):
        return _list_settings(function, chosen)
    if verb == "reconstruct" and chosen["output"] is None:
        from clothtrack.api.learning import default_mesh

        chosen["output"] = default_mesh(chosen["picture"], chosen["frame"])
    offered = {
        "progress": progress,
        "opened": partial(_opened, verb, json=json),
        "each": lambda one: None if json else say(one.text()),
    }
    known = inspect.signature(function).parameters
    heard = {name: value for name, value in offered.items() if name in known}
    return _say(verb, function(**chosen, **heard), json=json, said="each" in known and not json)


def _opened(verb: str, address: str, *, json: bool) -> None:
    """Print the address of a page.

    With --json, standard output is reserved for the result, so the address goes to standard error.
    A view has no other result and prints the address itself as JSON.
    """
    watched = verb in ("track", "live", "flatten")
    text = f"{address}   open this{' to watch' if watched else '; Ctrl-C ends'}"
    if verb == "view":
        say_result(text, {"address": address}, json=json)
    elif json:
        complain(text)
    else:
        say(text)


def _say(verb: str, result: Any, *, json: bool, said: bool) -> int:
    """Print the result of a verb and return its exit code."""
    if result is None:
        return 0
    if isinstance(result, Path):
        say_result(str(result), {"written": result}, json=json)
        return 0
    if json:
        document = result.as_dict()
        # A single inspected artifact is printed as one document instead of a list.
        say_result(
            "", document[0] if verb == "inspect" and len(document) == 1 else document, json=True
        )
    elif not said and (text := result.text()):
        say(text)
    for doubt in getattr(result, "doubts", ()):
        complain(doubt)
    return getattr(result, "exit_code", 0)


def _list_settings(function: Function, chosen: Mapping[str, Any]) -> int:
    """Print every setting of a verb with its value and meaning, group by group."""
    from clothtrack.files.settings import settings_of

    make = configuration_of(function)
    assert make is not None
    names = inspect.signature(make).parameters
    config = make(**{name: chosen[name] for name in names if chosen.get(name) is not None})
    for group, members in groupby(settings_of(config), attrgetter("group")):
        say(f"\n[{group}]" if group else "[top]")
        for setting in members:
            say(f"{setting.name}={setting.value}    {setting.meaning}")
    return 0
