"""The command line: one verb per stage, in the order of the method.

A verb parses its options, calls what `import clothtrack` offers or one function of a room, and says
what came of it. The stages are imported when their verb is called, so that `--help` is instant.
Exit codes: 0 done, 1 bad input or a full disk (one clear line on standard error), 2 wrong usage
(one line, too), 130 an interrupt.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points

from clothtrack.cli.garment import garment
from clothtrack.cli.learn import finetune, label, pretrain, reconstruct
from clothtrack.cli.look import evaluate, export, view
from clothtrack.cli.recordings import inspect
from clothtrack.cli.signature import name_of
from clothtrack.cli.terminal import INTERRUPTED, complain, end_by_interrupt, exit_code, say
from clothtrack.cli.track import demo, track
from clothtrack.cli.usage import WRONG_USAGE, WrongUsageError, overview, parse
from clothtrack.cli.verify import verify
from clothtrack.cli.versions import versions
from clothtrack.cli.warnings_once import logged

OWN: tuple[Callable[..., int], ...] = (
    demo, inspect, garment, track, label, pretrain, finetune, reconstruct, evaluate, view, export,
    verify,
)  # fmt: skip
"""The functions behind the verbs of the core."""

VERBS: tuple[Callable[..., int], ...] = (
    *OWN,
    *(found.load() for found in entry_points(group="clothtrack.verbs")),
)
"""The same with those of other packages, which name theirs as entry points."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    "the main path": ("demo", "import", "track", "evaluate", "view"),
    "recordings": (
        "inspect", "record", "calibrate-camera", "calibrate-hand-eye", "segment", "find-picker",
        "garment",
    ),
    "learning": ("reconstruct", "label", "finetune", "pretrain"),
    "a robot": ("flatten", "train-dynamics"),
    "results": ("export", "verify"),
    "the simulated world": ("simulate", "bench"),
}  # fmt: skip
"""The order of `--help`; a verb that is in no group comes last."""


THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that numeric libraries read when they are loaded. The operations here are small, and
threads wait for each other more than they compute: on a busy machine several times as long."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        arguments: the words after `clothtrack`; those of the process by default.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["--version"]:
        return exit_code(lambda: versions(json="--json" in words))
    try:
        verbs = {name_of(verb): verb for verb in VERBS}
        if words[:1] in (["-h"], ["--help"]):
            say(overview(verbs, GROUPS))
            return 0
        run = parse(words, verbs)
    except WrongUsageError as wrong:
        complain(str(wrong))
        return WRONG_USAGE
    for variable in THREADS:
        os.environ.setdefault(variable, "1")
    with logged(verbose="--verbose" in words):
        code = exit_code(lambda: _quietly(run))
    if code == INTERRUPTED and arguments is None:
        end_by_interrupt()
    return code


def _quietly(run: Callable[[], int]) -> int:
    """Tell Warp first not to greet on standard output, where our results go."""
    from clothtrack.geometry.devices import quiet_warp

    quiet_warp()
    return run()
